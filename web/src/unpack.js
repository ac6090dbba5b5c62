// Arrays as warpcontact/visualize/report/packing.py writes them.

const HIGHEST = 65535; // of 16 bits: NaN

/** Returns the content of a data block of the page, or null. */
export function block(name) {
  const element = document.getElementById(`data-${name}`);
  return element ? JSON.parse(element.textContent) : null;
}

/** Returns the arrays of a pack, each as {shape, data}. */
export async function unpack(pack) {
  const packed = Uint8Array.from(atob(pack.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let place = 0;
  const found = [];
  for (const about of pack.arrays) {
    if (about.type === "same") {
      found.push(found[about.of]);
      continue;
    }
    const size = about.shape.reduce((product, length) => product * length, 1);
    const [data, used] = DECODERS[about.type](bytes, place, size, about);
    place += used;
    found.push({ shape: about.shape, data });
  }
  return found;
}

const DECODERS = {
  float(bytes, place, size) {
    return [new Float32Array(bytes.slice(place, place + 4 * size).buffer), 4 * size];
  },

  index(bytes, place, size) {
    const data = new Uint32Array(size);
    let value = 0;
    for (let i = 0; i < size; i++) {
      for (let b = 0; b < 4; b++) value = (value + bytes[place + b * size + i] * 2 ** (8 * b)) % 2 ** 32;
      data[i] = value;
    }
    return [data, 4 * size];
  },

  short(bytes, place, size, about) {
    const rows = about.shape[0];
    const row = size / rows;
    const axes = about.low.length;
    const data = new Float32Array(size);
    for (let j = 0; j < row; j++) {
      const low = about.low[j % axes];
      const step = about.step[j % axes];
      let value = 0;
      for (let t = 0; t < rows; t++) {
        const at = place + j * rows + t;
        value = (value + bytes[at] + 256 * bytes[at + size]) & HIGHEST;
        data[t * row + j] = value === HIGHEST ? NaN : low + step * value;
      }
    }
    return [data, 2 * size];
  },
};
