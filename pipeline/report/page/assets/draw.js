// Draws the charts that come with the page, in the colours of the theme.

export const report = JSON.parse(document.getElementById("report").textContent);
export const byId = (id) => document.getElementById(id);
const darkSystem = window.matchMedia("(prefers-color-scheme: dark)");

export const isDark = () => {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : darkSystem.matches;
};

// What a colour such as var(--ink) is under the theme of now.
export function paint(colour) {
  const name = /^var\((--\w+)\)$/.exec(colour);
  return name ? getComputedStyle(document.documentElement).getPropertyValue(name[1]).trim() : colour;
}

const isPrinting = () => document.documentElement.dataset.printing === "yes";

// A copy of a chart in the colours of now; only what is named a colour is one, so that no name of a pair is.
export const themed = (chart) =>
  JSON.parse(JSON.stringify(chart), (key, value) =>
    key.endsWith("color") && typeof value === "string" ? paint(value) : value,
  );

const resizes = new ResizeObserver((changes) => {
  for (const { target } of changes) if (target.offsetWidth) Plotly.Plots.resize(target);
});

// Draws or redraws a chart. It follows the size of its container, also if that was hidden meanwhile.
export function draw(id, { data, layout }, config = {}) {
  // Buttons are listed one by one: plotly's own choice includes one that uploads the chart.
  const modeBarButtons = [["toImage"]];
  const shared = { displaylogo: false, displayModeBar: false, modeBarButtons, plotlyServerURL: "" };
  const { offsetWidth: width, offsetHeight: height } = byId(id);
  const size = isPrinting() ? { width, height } : {};
  Plotly.react(id, data, { ...layout, ...size, template: themed(report.template) }, { ...shared, ...config });
  resizes.observe(byId(id));
}

export function drawCharts() {
  for (const [id, chart] of Object.entries(report.charts)) draw(id, themed(chart));
}

// Lets the browser show what is drawn, and hear its user, before more is drawn.
export const pause = () => new Promise((done) => setTimeout(done));

// redraw: what else has the colours of the theme
export async function startCharts(redraw = () => {}) {
  for (const [id, chart] of Object.entries(report.charts)) {
    draw(id, themed(chart));
    await pause();
  }
  darkSystem.addEventListener("change", () => {
    drawCharts();
    redraw();
  });
  startPrinting(redraw);
  document.documentElement.dataset.ready = "yes";
}

// On paper all is light, and as wide as the paper.
function startPrinting(redraw) {
  const { dataset } = document.documentElement;
  let theme;
  window.addEventListener("beforeprint", () => {
    theme = dataset.theme;
    dataset.theme = "light";
    dataset.printing = "yes";
    drawCharts();
    redraw();
  });
  window.addEventListener("afterprint", () => {
    if (theme) dataset.theme = theme;
    else delete dataset.theme;
    delete dataset.printing;
    drawCharts();
    redraw();
  });
}
