// Builds ../warpcontact/visualize/report/page.js: `npm ci && npm run build`. Its first line has the SHA-256 of its
// sources; a test compares it with the present sources.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const target = join(here, "../warpcontact/visualize/report/page.js");

/** SHA-256 over name and content of each source, by name; the test computes the same. */
function digestOfSources() {
  const sources = readdirSync(join(here, "src")).filter((name) => name.endsWith(".js")).map((name) => `src/${name}`);
  const hash = createHash("sha256");
  for (const name of ["build.mjs", "package-lock.json", "package.json", ...sources.sort()]) {
    hash.update(`${name}\n`).update(readFileSync(join(here, name)));
  }
  return hash.digest("hex");
}

const three = JSON.parse(readFileSync(join(here, "node_modules/three/package.json"), "utf8"));
const { outputFiles } = await build({
  entryPoints: [join(here, "src/main.js")],
  bundle: true,
  minify: true,
  write: false,
  format: "iife",
  target: "es2022",
  charset: "ascii",
  legalComments: "none", // the banner has them, and so has THIRD_PARTY_NOTICES
});
const script = outputFiles[0].text.trim();
if (/<\/script|<!--/i.test(script)) throw new Error("the script would end the element that it is in");
const banner =
  `/*! warpcontact, Apache-2.0; three.js ${three.version}, (c) three.js authors, MIT; ` +
  `sources sha256 ${digestOfSources()} */`;
writeFileSync(target, `${banner}\n${script}\n`);
console.log(`${target}: ${script.length} bytes`);
