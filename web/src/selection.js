// What the reader looks at: an environment and a time. Charts, table and replay follow it.

const followers = { env: [], time: [] };
export const selection = { env: null, time: 0 };

/** Calls `follow(value)` whenever "env" or "time" changes. */
export function follow(what, callback) {
  followers[what].push(callback);
}

export function select(what, value) {
  if (selection[what] === value) return;
  selection[what] = value;
  for (const callback of followers[what]) callback(value);
}
