// Tables that sort by any column and filter by text; rows come as they are, worst first. Names from the data reach the
// page only as text (textContent), and with the signs that would steer the text around them shown by their numbers.

import { report } from "./draw.js";

const ROWS_AT_ONCE = 100;
export const NULL_SIGN = "–";
const steering = new RegExp(report.steering, "g");
export const shown = (text) =>
  String(text).replace(steering, (sign) => `\\u${sign.charCodeAt(0).toString(16).padStart(4, "0")}`);
export const shorten = (text, most = 22) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);
export const counted = (n) => n.toLocaleString("en");

export function number(value, digits = 3) {
  if (value === null || value === undefined) return NULL_SIGN;
  return Number.isInteger(value) ? counted(value) : value.toFixed(digits);
}

export function element(tag, text, attributes = {}, ...children) {
  const made = document.createElement(tag);
  if (text !== null && text !== undefined) made.textContent = shown(text);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

export const records = (columns, rows) =>
  rows.map((row) => Object.fromEntries(columns.map((column, i) => [column, row[i]])));

const COMPARE = {
  "<": (a, b) => a < b,
  ">": (a, b) => a > b,
  "<=": (a, b) => a <= b,
  ">=": (a, b) => a >= b,
  "=": (a, b) => a === b,
};

const plainText = (text) => String(text).toLowerCase().replace(/\s+/g, " ").trim();

// The column that a text ends with, by key or heading, with its unit or without, and the words before it.
function columnAtEnd(text, columns) {
  const names = columns.flatMap((column) =>
    [column.key, column.title, column.title.replace(/\s*\([^)]*\)$/, "")].map((name) => [plainText(name), column]),
  );
  const longestFirst = names.sort(([a], [b]) => b.length - a.length);
  const found = longestFirst.find(([name]) => text === name || text.endsWith(` ${name}`));
  return found && { column: found[1], before: text.slice(0, text.length - found[0].length) };
}

// Rows that match a filter such as "wall range (m) > 30": all its words and all its bounds hold. A bound that cannot be
// read is ignored, with the reason in `problem`.
function filterRows(filter, columns, rows) {
  const text = (row) =>
    columns
      .filter((column) => column.text)
      .map((column) => plainText(row[column.key] ?? ""))
      .join(" ");
  const [bounds, words, problems] = [[], [], []];
  const add = (found) => words.push(...plainText(found).split(" ").filter(Boolean));
  const bound = /([^<>=]*?)\s*(<=|>=|<|>|=)\s*("[^"]*"|\S*)/g;
  let end = 0;
  for (const [whole, left, sign, right] of filter.matchAll(bound)) {
    end = filter.indexOf(whole, end) + whole.length;
    const own = columnAtEnd(plainText(left), columns);
    const word = plainText(whole)
      .split(" ")
      .find((part) => part.includes(sign));
    if (!own && word !== sign && rows.some((row) => text(row).includes(word))) {
      add(whole);
      continue;
    }
    if (!own) {
      const name = /\S+(\s*\([^)]*\))?$/.exec(left.trim())?.[0] ?? "";
      add(left.trim().slice(0, left.trim().length - name.length));
      problems.push(`no such column: ${name || "(none)"}. There are: ${columns.map(({ title }) => title).join("; ")}.`);
      continue;
    }
    add(own.before);
    const { key, title, text: isText } = own.column;
    const value = right.replaceAll('"', "");
    if (isText && sign === "=") bounds.push((row) => plainText(row[key] ?? "") === plainText(value));
    else if (isText) problems.push(`${title} is text: expected ${title} = "some text".`);
    else if (value === "" || Number.isNaN(Number(value)))
      problems.push(`${title} ${sign} ${value || "?"}: expected a number.`);
    else bounds.push((row) => typeof row[key] === "number" && COMPARE[sign](row[key], Number(value)));
  }
  add(filter.slice(end));
  const isShown = (row) => bounds.every((holds) => holds(row)) && words.every((word) => text(row).includes(word));
  return { isShown, problem: problems.join(" ") };
}

// Order of two values, nulls last in both directions.
function order(a, b, isUp) {
  if (a === null || b === null) return (a === null) - (b === null);
  const step =
    typeof a === "number" && typeof b === "number"
      ? a - b
      : String(a).localeCompare(String(b), "en", { numeric: true });
  return isUp ? step : -step;
}

// table: {columns: [{key, title, about, text, up, digits}], rows, note}
// action(row): the address that the row's first cell leads to, a function that it calls, or null
export function makeTable(place, what, { columns, rows: lists, note }, action) {
  const rows = records(
    columns.map(({ key }) => key),
    lists,
  );
  const state = { sort: null, isUp: true, n: ROWS_AT_ONCE };
  const filter = element("input", null, {
    type: "search",
    "aria-label": `Filter ${what}`,
    placeholder: "words, or r_lambda > 0.5",
    title: `Words, and bounds on columns: ${columns.map((column) => column.title).join("; ")}`,
  });
  const count = element("p", null, { class: "note", role: "status" });
  const body = element("tbody");
  const heads = columns.map((column) => {
    const title = column.about ? `${column.title}. ${column.about}` : column.title;
    const button = element("button", column.title, { type: "button", title });
    button.addEventListener("click", () => {
      state.isUp = state.sort === column.key ? !state.isUp : column.text || column.up;
      state.sort = column.key;
      fill();
    });
    return element("th", null, { scope: "col", class: column.text ? "text" : "" }, button);
  });
  const table = element("table", null, {}, element("thead", null, {}, element("tr", null, {}, ...heads)), body);
  const more = element("button", "Show more", { type: "button" });
  more.addEventListener("click", () => {
    state.n += 5 * ROWS_AT_ONCE;
    fill();
  });
  filter.addEventListener("input", () => {
    state.n = ROWS_AT_ONCE;
    fill();
  });
  const clear = element("button", "Nothing matches: clear the filter", { type: "button" });
  clear.addEventListener("click", () => {
    filter.value = "";
    fill();
    filter.focus();
  });
  const box = element(
    "div",
    null,
    { class: "box", tabindex: 0, role: "region", "aria-label": `Table of ${what}` },
    table,
  );
  const hint = element("p", "more columns on the right: scroll \u2192", { class: "note scroll" });
  const isWider = () => hint.classList.toggle("needed", box.scrollWidth - box.clientWidth - box.scrollLeft > 2);
  box.addEventListener("scroll", isWider);
  new ResizeObserver(isWider).observe(box);
  place.append(
    element("div", null, { class: "controls" }, element("label", "Filter ", {}, filter)),
    count,
    hint,
    box,
    clear,
    more,
  );

  function cellOf(row, column, isFirst) {
    const value = row[column.key];
    const text = typeof value === "number" ? number(value, column.digits) : (value ?? NULL_SIGN);
    if (!column.text) return element("td", text);
    const does = isFirst ? action(row) : null;
    if (does === null) return element("td", text, { class: "text", dir: "auto", title: shown(text) });
    const isLink = typeof does === "string";
    const inside = isLink
      ? element("a", text, { href: does, title: shown(text) })
      : element("button", text, { type: "button", title: `Show ${shown(text)}` });
    if (!isLink) inside.addEventListener("click", does);
    return element("td", null, { class: "text", dir: "auto" }, inside);
  }

  function fill() {
    const { isShown, problem } = filterRows(filter.value, columns, rows);
    const chosen = rows.filter(isShown);
    if (state.sort !== null) chosen.sort((a, b) => order(a[state.sort], b[state.sort], state.isUp));
    const first = chosen.slice(0, state.n);
    body.replaceChildren(
      ...first.map((row) => element("tr", null, {}, ...columns.map((column, k) => cellOf(row, column, k === 0)))),
    );
    heads.forEach((head, k) => {
      head.setAttribute("aria-sort", columns[k].key !== state.sort ? "none" : state.isUp ? "ascending" : "descending");
    });
    const part = first.length < chosen.length ? `, the first ${first.length} shown` : "";
    count.textContent = `${problem ? `${shown(problem)} ` : ""}${counted(chosen.length)} of ${counted(rows.length)} ${what}${part}. ${state.sort === null ? note : ""}`;
    more.hidden = first.length === chosen.length;
    clear.hidden = chosen.length > 0 || filter.value === "";
  }
  fill();
}
