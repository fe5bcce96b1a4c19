"use strict";
// Tables that sort by any column and filter by text; rows come as they are, worst first.

const ROWS_AT_ONCE = 100;

// columns: {key, title, text?: bool, digits?}; action(row) gives a function or an address, or null, for the first cell.
function makeTable(place, what, columns, rows, action, note) {
  const state = { sort: null, up: true, filter: "", shown: ROWS_AT_ONCE };
  const texts = rows.map((row) => columns.filter((column) => column.text).map((column) => String(row[column.key] ?? "")).join(" ").toLowerCase());
  const filter = element("input", null, { type: "search", "aria-label": `Filter ${what}`, placeholder: "words, or r_lambda > 0.5" });
  const label = element("label", "Filter ");
  label.append(filter);
  const controls = element("div", null, { class: "controls" });
  controls.append(label);
  const count = element("p", null, { class: "note", role: "status" });
  const box = element("div", null, { class: "box", tabIndex: 0, role: "region", "aria-label": `Table of ${what}` });
  const table = element("table");
  const head = element("thead");
  const body = element("tbody");
  const headRow = element("tr");
  for (const column of columns) {
    const cell = element("th", null, { scope: "col", class: column.text ? "text" : "" });
    const button = element("button", column.title, { type: "button" });
    button.addEventListener("click", () => {
      state.up = state.sort === column.key ? !state.up : Boolean(column.text || column.up);
      state.sort = column.key;
      fill();
    });
    cell.append(button);
    headRow.append(cell);
  }
  head.append(headRow);
  table.append(head, body);
  box.append(table);
  const more = element("button", "Show more", { type: "button" });
  more.addEventListener("click", () => { state.shown += 5 * ROWS_AT_ONCE; fill(); });
  filter.addEventListener("input", () => { state.filter = filter.value; state.shown = ROWS_AT_ONCE; fill(); });
  place.append(controls, count, box, more);

  function wanted() {
    const terms = [];
    const words = state.filter.replace(/([a-z_]+)\s*(<=|>=|<|>|=)\s*(-?[\d.]+)/gi, (_, key, sign, value) => {
      const column = columns.find((of) => of.key === key.toLowerCase() || of.title.toLowerCase() === key.toLowerCase());
      if (!column) return _;
      const compare = { "<": (a, b) => a < b, ">": (a, b) => a > b, "<=": (a, b) => a <= b, ">=": (a, b) => a >= b, "=": (a, b) => a === b }[sign];
      terms.push((row) => typeof row[column.key] === "number" && compare(row[column.key], Number(value)));
      return " ";
    }).toLowerCase().split(/\s+/).filter(Boolean);
    return rows.map((_, i) => i).filter((i) => words.every((word) => texts[i].includes(word)) && terms.every((term) => term(rows[i])));
  }

  function order(indices) {
    if (state.sort === null) return indices;
    const sign = state.up ? 1 : -1;
    const value = (i) => rows[i][state.sort];
    return [...indices].sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x === null || y === null) return x === y ? a - b : x === null ? 1 : -1; // nulls last, whichever way
      if (typeof x === "number" && typeof y === "number") return sign * (x - y) || a - b;
      return sign * String(x).localeCompare(String(y), "en", { numeric: true }) || a - b;
    });
  }

  function fill() {
    const found = order(wanted());
    body.replaceChildren(...found.slice(0, state.shown).map((i) => {
      const line = element("tr");
      columns.forEach((column, k) => {
        const value = rows[i][column.key];
        const text = typeof value === "number" ? number(value, column.digits) : value ?? "–";
        const cell = element("td", null, { class: column.text ? "text" : "" });
        const does = k === 0 ? action(rows[i]) : null;
        if (typeof does === "string") cell.append(element("a", text, { href: does, title: text }));
        else if (does) {
          const button = element("button", text, { type: "button", title: `Show ${text}` });
          button.addEventListener("click", does);
          cell.append(button);
        } else {
          cell.textContent = shown(text);
          if (column.text) cell.title = shown(text);
        }
        if (column.text) cell.dir = "auto";
        line.append(cell);
      });
      return line;
    }));
    columns.forEach((column, k) => {
      const sort = column.key === state.sort ? (state.up ? "ascending" : "descending") : "none";
      headRow.cells[k].setAttribute("aria-sort", sort);
    });
    const nShown = Math.min(found.length, state.shown);
    count.textContent = `${found.length.toLocaleString("en")} of ${rows.length.toLocaleString("en")} ${what}${nShown < found.length ? `, the first ${nShown} shown` : ""}. ${state.sort === null ? note : ""}`;
    more.hidden = nShown >= found.length;
  }
  fill();
}

function makeKeyTable(place, groups) {
  const table = element("table");
  for (const [group, values] of Object.entries(groups)) {
    for (const [name, value] of Object.entries(values)) {
      const line = element("tr");
      line.append(element("td", group ? `${group}.${name}` : name, { class: "text" }), element("td", value === null ? "none" : String(value), { class: "text", title: String(value) }));
      table.append(line);
    }
  }
  place.append(table);
}
