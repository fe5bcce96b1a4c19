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

// Order of two cells by their numbers or else their texts; those without a value come last in both directions.
function order(a, b, isUp) {
  if (a === "-" || b === "-") return (a === "-") - (b === "-");
  const step = Number.isNaN(a - b) ? a.localeCompare(b, "en", { numeric: true }) : a - b;
  return isUp ? step : -step;
}

// Makes the table of a place sort and filter. Words begin with the first, numbers with the largest.
export function startTable(place) {
  const [filter, count, body] = ["input", ".count", "tbody"].map((part) => place.querySelector(part));
  const rows = [...body.rows];
  const heads = [...place.querySelectorAll("th")];
  heads.forEach((head, k) => {
    const button = element("button", head.textContent, { type: "button", title: head.textContent });
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const before = head.ariaSort;
      const isUp = before ? before === "descending" : head.className === "text";
      for (const other of heads) other.ariaSort = null;
      head.ariaSort = isUp ? "ascending" : "descending";
      const textOf = (row) => row.cells[k].textContent;
      body.append(...rows.sort((a, b) => order(textOf(a), textOf(b), isUp)));
    });
  });
  function choose() {
    const asked = filter.value.toLowerCase();
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(asked);
    count.textContent = `${counted(rows.filter((row) => !row.hidden).length)} of ${counted(rows.length)}`;
  }
  filter.addEventListener("input", choose);
  choose();
}
