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
  const texts = columns.filter((column) => column.text);
  const textOf = (row) => texts.map(({ key }) => plainText(row[key] ?? "")).join(" ");
  const [bounds, problems] = [[], []];
  const rest = filter.replace(/([^<>=]*?)\s*(<=|>=|<|>|=)\s*("[^"]*"|\S*)/g, (whole, left, sign, right) => {
    const own = columnAtEnd(plainText(left), columns);
    if (!own) {
      const words = plainText(whole).split(" ");
      const word = words.find((part) => part.includes(sign));
      if (word !== sign && rows.some((row) => textOf(row).includes(word))) return whole;
      const name = /\S+(\s*\([^)]*\))?$/.exec(left.trim())?.[0] ?? "";
      problems.push(`no such column: ${name || "(none)"}. There are: ${columns.map(({ title }) => title).join("; ")}.`);
      return `${left.trim().slice(0, left.trim().length - name.length)} `;
    }
    const { key, title, text: isText } = own.column;
    const value = right.replaceAll('"', "");
    if (isText && sign === "=") bounds.push((row) => plainText(row[key] ?? "") === plainText(value));
    else if (isText) problems.push(`${title} is text: expected ${title} = "some text".`);
    else if (value === "" || Number.isNaN(Number(value)))
      problems.push(`${title} ${sign} ${value || "?"}: expected a number.`);
    else bounds.push((row) => typeof row[key] === "number" && COMPARE[sign](row[key], Number(value)));
    return `${own.before} `;
  });
  const words = plainText(rest).split(" ");
  const isShown = (row) => bounds.every((holds) => holds(row)) && words.every((word) => textOf(row).includes(word));
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

// table: {keys, rows, note}; report.columns describes each key: {title, about, text, up, digits}
// linkOf(row): the address that the row's first cell leads to, or null
export function startTable(place, what, { keys, rows: lists, note }, linkOf) {
  const rows = records(keys, lists);
  const columns = keys.map((key) => ({ key, ...report.columns[key] }));
  const state = { sort: null, isUp: true, n: ROWS_AT_ONCE };
  const part = (selector) => place.querySelector(selector);
  const [filter, count, body] = ["input", ".count", "tbody"].map(part);
  const [clear, more] = [".clear", ".more"].map(part);
  filter.title = `Words, and bounds on columns: ${columns.map(({ title }) => title).join("; ")}`;
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
  part("thead tr").replaceChildren(...heads);
  more.addEventListener("click", () => fill(state.n + 5 * ROWS_AT_ONCE));
  filter.addEventListener("input", () => fill(ROWS_AT_ONCE));
  clear.addEventListener("click", () => {
    filter.value = "";
    fill();
    filter.focus();
  });

  function cellOf(row, column, isFirst) {
    const value = row[column.key];
    const text = typeof value === "number" ? number(value, column.digits) : (value ?? NULL_SIGN);
    if (!column.text) return element("td", text);
    const href = isFirst ? linkOf(row) : null;
    const look = { class: "text", dir: "auto", title: shown(text) };
    return href === null ? element("td", text, look) : element("td", null, look, element("a", text, { href }));
  }

  function fill(n = state.n) {
    state.n = n;
    const { isShown, problem } = filterRows(filter.value, columns, rows);
    const chosen = rows.filter(isShown);
    if (state.sort !== null) chosen.sort((a, b) => order(a[state.sort], b[state.sort], state.isUp));
    const first = chosen.slice(0, n);
    body.replaceChildren(
      ...first.map((row) => element("tr", null, {}, ...columns.map((column, k) => cellOf(row, column, k === 0)))),
    );
    heads.forEach((head, k) => {
      head.setAttribute("aria-sort", columns[k].key !== state.sort ? "none" : state.isUp ? "ascending" : "descending");
    });
    const some = first.length < chosen.length ? `, the first ${first.length} shown` : "";
    count.textContent = `${problem ? `${shown(problem)} ` : ""}${counted(chosen.length)} of ${counted(rows.length)} ${what}${some}. ${state.sort === null ? note : ""}`;
    more.hidden = first.length === chosen.length;
    clear.hidden = chosen.length > 0 || filter.value === "";
  }
  fill();
}
