// What is typed above the table, as a test of its rows: `mass > 1 status = frozen 12-20`.

const CONDITION = /(?:"([^"]*)"|([^\s<>=!"]+))\s*(<=|>=|!=|=|<|>)\s*("[^"]*"|[^\s]+)/g;

const TESTS = {
  "<": (a, b) => a < b,
  ">": (a, b) => a > b,
  "<=": (a, b) => a <= b,
  ">=": (a, b) => a >= b,
  "=": (a, b) => a === b,
  "!=": (a, b) => a !== b,
};

/** Returns {test(row), problem}: the rows that `text` asks for; all, where it is not understood. */
export function filterOf(text, table) {
  const tests = [];
  let problem = "";
  const rest = text.replace(CONDITION, (_, quoted, plain, operator, word) => {
    const name = quoted ?? plain;
    const found = findColumn(name, table);
    if (typeof found === "string") problem ||= found;
    else tests.push(condition(found, operator, word.replaceAll('"', "")));
    return " ";
  });
  for (const word of rest.split(/\s+/).filter(Boolean)) tests.push(plainWord(word, table));
  return { test: problem ? () => true : (row) => tests.every((test) => test(row)), problem };
}

function findColumn(name, table) {
  const wanted = name.toLowerCase();
  if (["env", "environment"].includes(wanted)) return { values: table.env, words: {} };
  const columns = table.columns;
  const exact = columns.filter((column) => column.name.toLowerCase() === wanted);
  const near = exact.length ? exact : columns.filter((column) => column.name.toLowerCase().includes(wanted));
  if (near.length === 1) return near[0];
  return near.length ? `${name}: ${near.length} columns have this in their name` : `${name}: no such column`;
}

function condition(column, operator, word) {
  const test = TESTS[operator];
  const codes = Object.entries(column.words);
  const code = codes.find(([, meaning]) => meaning.toLowerCase() === word.toLowerCase());
  const wanted = code ? Number(code[0]) : Number(word.replace("−", "-"));
  if (["nan", "–", "-"].includes(word.toLowerCase())) return (row) => test(column.values[row] === null, true);
  if (Number.isNaN(wanted)) return () => operator === "!=";
  return (row) => column.values[row] !== null && test(column.values[row], wanted);
}

function plainWord(word, table) {
  const range = /^(\d+)(?:[-–](\d+))?$/.exec(word);
  if (range) {
    const first = Number(range[1]);
    const last = Number(range[2] ?? range[1]);
    return (row) => table.env[row] >= first && table.env[row] <= last;
  }
  const wanted = word.toLowerCase();
  const coded = table.columns.filter((column) => Object.keys(column.words).length);
  return (row) => coded.some((column) => (column.words[column.values[row]] ?? "").toLowerCase().includes(wanted));
}
