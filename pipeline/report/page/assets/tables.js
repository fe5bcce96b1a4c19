// Tables that sort by any column, with a filter for the text of a row; rows come as they are, worst first. Names from
// the data reach the page only as text (textContent), and with the signs that would steer the text around them shown by
// their numbers.

import { report } from "./draw.js";

const NULL_SIGN = "–";
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

// A value of a column as the page shows it.
export function cellText(value, { digits }) {
  return typeof value === "number" ? number(value, digits) : (value ?? NULL_SIGN);
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
  const state = { sort: null, isUp: true };
  const part = (selector) => place.querySelector(selector);
  const [filter, count, body] = ["input", ".count", "tbody"].map(part);
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
  filter.addEventListener("input", fill);

  function cellOf(row, column, isFirst) {
    const text = cellText(row[column.key], column);
    if (!column.text) return element("td", text);
    const href = isFirst ? linkOf(row) : null;
    const look = { class: "text", dir: "auto", title: shown(text) };
    return href === null ? element("td", text, look) : element("td", null, look, element("a", text, { href }));
  }

  const rowText = (row) => columns.map((column) => cellText(row[column.key], column)).join(" ");

  function fill() {
    const asked = filter.value.toLowerCase();
    const chosen = rows.filter((row) => rowText(row).toLowerCase().includes(asked));
    if (state.sort !== null) chosen.sort((a, b) => order(a[state.sort], b[state.sort], state.isUp));
    body.replaceChildren(
      ...chosen.map((row) => element("tr", null, {}, ...columns.map((column, k) => cellOf(row, column, k === 0)))),
    );
    heads.forEach((head, k) => {
      head.setAttribute("aria-sort", columns[k].key !== state.sort ? "none" : state.isUp ? "ascending" : "descending");
    });
    count.textContent = `${counted(chosen.length)} of ${counted(rows.length)} ${what}. ${state.sort === null ? note : ""}`;
  }
  fill();
}
