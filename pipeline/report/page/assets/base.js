"use strict";
// What all parts share: the report's data, small DOM helpers, colours, the theme. Names from the data reach the page
// only as text (textContent) or through plotText.

const report = JSON.parse(document.getElementById("report").textContent);
const byId = (id) => document.getElementById(id);

// Okabe and Ito's colours; the same in the figures. On black their blue is too dark, sky blue takes its place.
const blue = () => (isDark() ? "#56B4E9" : "#0072B2");
const COLOURS = { get real() { return blue(); }, sim: "#D55E00", get r_lambda() { return blue(); }, cdc: "#E69F00" };
const FATES = { matched: "#999999", get missing() { return blue(); }, hallucinated: "#D55E00", "too small": "#CC79A7" };
const QUADRANT_COLOURS = { faithful: "#009E73", "structure lost": "#E69F00", displaced: "#56B4E9", failed: "#D55E00", "no score": "#999999" };
const NONE = "#999999";
// Parts of plasma that are seen on white and on black.
const RAMPS = {
  light: ["#0d0887", "#5302a3", "#8b0aa5", "#b83289", "#db5c68", "#fca636"],
  dark: ["#6a00a8", "#9c179e", "#cc4778", "#ed7953", "#fdb42f", "#f0f921"],
};

// Signs that steer the text around them (direction marks, controls) are shown by their number instead.
const shown = (text) =>
  String(text).replace(/[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g, (sign) => `\\u${sign.charCodeAt(0).toString(16).padStart(4, "0")}`);
const say = (id, text) => { byId(id).textContent = shown(text); };

function element(tag, text, options = {}) {
  const made = document.createElement(tag);
  if (text !== undefined && text !== null) made.textContent = shown(text);
  for (const [name, value] of Object.entries(options)) {
    if (name === "class") made.className = value;
    else if (name in made) made[name] = value;
    else made.setAttribute(name, value);
  }
  return made;
}

// Plotly reads a little markup in its texts: take its meaning away, and shorten.
const shorten = (text, most = 22) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);
const plotText = (text, most) =>
  shorten(shown(text), most).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

function number(value, digits = 3) {
  if (value === null || value === undefined) return "–";
  if (Number.isInteger(value)) return value.toLocaleString("en");
  return value.toFixed(digits);
}

function decode(text, Type) {
  const bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  return new Type(bytes.buffer);
}

function records(columns, rows) {
  return rows.map((row) => Object.fromEntries(columns.map((column, i) => [column, row[i]])));
}

const isDark = () => {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches;
};
const ramp = () => RAMPS[isDark() ? "dark" : "light"];
const colourscale = () => ramp().map((colour, i, all) => [i / (all.length - 1), colour]);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function layout(more) {
  const axis = { gridcolor: css("--line"), zerolinecolor: css("--line"), linecolor: css("--soft"), automargin: true };
  const base = {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: css("--ink"), family: "system-ui, sans-serif", size: 12 },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--soft"), activecolor: css("--ink") },
    margin: { l: 55, r: 15, t: 30, b: 45 }, hoverlabel: { align: "left" },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
  };
  const merged = { ...base, ...more };
  for (const name of ["xaxis", "yaxis"]) merged[name] = { ...axis, ...(more[name] || {}) };
  return merged;
}

const CONFIG = { displaylogo: false, displayModeBar: false };
const charts = new ResizeObserver((changes) => {
  for (const { target } of changes) if (target.offsetWidth) Plotly.Plots.resize(target);
});

// Draws a chart, or draws it anew. It follows the size of its place, also when that was hidden meanwhile.
function draw(id, data, more, config = {}) {
  const done = Plotly.react(id, data, layout(more), { ...CONFIG, ...config });
  charts.observe(byId(id));
  return done;
}
