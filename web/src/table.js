// The table of environments: sorted by its heads, filtered, page by page.
import { filterOf } from "./filter.js";
import { number } from "./numbers.js";
import { follow, select, selection } from "./selection.js";
import { block } from "./unpack.js";

const PAGE = 50;

export function startTable(replayed) {
  const data = block("environments");
  const place = document.getElementById("environments-table");
  if (data && place) new Table(data, place, replayed).show();
}

class Table {
  constructor(data, place, replayed) {
    this.data = data;
    this.replayed = replayed;
    this.rows = data.env.map((_, i) => i);
    this.order = { column: -1, falling: false };
    this.page = 0;
    this.count = document.getElementById("environments-count");
    this.pages = document.getElementById("environments-pages");
    this.input = document.getElementById("environments-filter");
    this.table = place.appendChild(make("table", { className: "facts environments" }));
    this.head = this.table.createTHead().insertRow();
    this.body = this.table.createTBody();
    this.#makeHead();
    document.getElementById("environments-form").addEventListener("submit", (event) => event.preventDefault());
    this.input.addEventListener("input", () => {
      this.page = 0;
      this.show();
    });
    follow("env", () => this.#mark());
  }

  show() {
    const { test, problem } = filterOf(this.input.value, this.data);
    const rows = this.rows.filter(test);
    this.input.setAttribute("aria-invalid", String(Boolean(problem)));
    this.count.textContent = problem || `${rows.length} of ${this.rows.length}`;
    this.#sort(rows);
    const last = Math.max(0, Math.ceil(rows.length / PAGE) - 1);
    this.page = Math.min(this.page, last);
    this.body.replaceChildren(...rows.slice(this.page * PAGE, (this.page + 1) * PAGE).map((row) => this.#line(row)));
    this.#showPages(rows.length, last);
    this.#mark();
  }

  #makeHead() {
    const all = [{ name: "env", unit: "", about: "number of the environment" }, ...this.data.columns];
    all.forEach((column, i) => {
      const cell = make("th", { scope: "col", className: Object.keys(column.words ?? {}).length ? "" : "number" });
      const button = make("button", { type: "button", className: "sort", title: `${column.name}: ${column.about}` });
      button.append(make("bdi", { textContent: shortened(column.name) }));
      if (column.unit) button.append(make("span", { className: "unit", textContent: column.unit }));
      button.addEventListener("click", () => {
        const same = this.order.column === i - 1;
        this.order = { column: i - 1, falling: same && !this.order.falling };
        this.show();
      });
      cell.append(button);
      this.head.append(cell);
    });
  }

  #sort(rows) {
    const { column, falling } = this.order;
    [...this.head.cells].forEach((cell, i) => {
      if (i - 1 === column) cell.setAttribute("aria-sort", falling ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
    const values = column < 0 ? this.data.env : this.data.columns[column].values;
    const sign = falling ? -1 : 1;
    rows.sort((a, b) => {
      const [x, y] = [values[a], values[b]];
      if (x === null || y === null) return (x === null) - (y === null); // unknown ones last
      return sign * (x - y) || a - b;
    });
  }

  #line(row) {
    const line = make("tr");
    const env = this.data.env[row];
    line.dataset.env = env;
    const first = line.insertCell();
    first.className = "number";
    if (this.replayed.has(env)) {
      const button = make("button", { type: "button", className: "link", textContent: env, title: "Show in the replay" });
      button.dataset.replay = env;
      first.append(button);
    } else {
      first.textContent = env;
      first.title = `Not in the replay of this file: warpcontact report DIR --envs ${env}`;
    }
    for (const column of this.data.columns) {
      const cell = line.insertCell();
      const value = column.values[row];
      const word = column.words[value];
      if (word === undefined) {
        cell.className = "number";
        cell.textContent = number(value);
      } else cell.textContent = word.toLowerCase().replaceAll("_", " ");
    }
    return line;
  }

  #showPages(count, last) {
    const turn = (text, label, step, off) => {
      const button = make("button", { type: "button", textContent: text, disabled: off, title: label });
      button.setAttribute("aria-label", label);
      button.addEventListener("click", () => {
        this.page += step;
        this.show();
      });
      return button;
    };
    const first = this.page * PAGE;
    const told = count ? `${first + 1} to ${Math.min(count, first + PAGE)} of ${count}` : "none";
    this.pages.replaceChildren(
      turn("‹", "Page before", -1, this.page === 0),
      make("span", { textContent: told }),
      turn("›", "Next page", 1, this.page === last),
    );
  }

  #mark() {
    for (const line of this.body.rows) line.classList.toggle("chosen", Number(line.dataset.env) === selection.env);
  }
}

/** Buttons anywhere in the page that name an environment. */
export function startLinks(replayed) {
  for (const button of document.querySelectorAll("button[data-replay]")) {
    if (!replayed.has(Number(button.dataset.replay))) button.disabled = true;
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest?.("button[data-replay]");
    if (!button) return;
    select("env", Number(button.dataset.replay));
    document.getElementById("replay-section")?.scrollIntoView({ block: "start" });
  });
}

function shortened(text) {
  return text.length > 40 ? `${text.slice(0, 39)}…` : text;
}

function make(tag, properties = {}) {
  return Object.assign(document.createElement(tag), properties);
}
