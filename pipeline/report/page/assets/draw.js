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
  const place = byId(id);
  resizes.observe(place);
  if (place.dataset.clicks) return;
  place.dataset.clicks = "yes";
  place.on("plotly_click", ({ points: [{ customdata: detail }] }) =>
    place.dispatchEvent(new CustomEvent("dot", { detail })),
  );
}

// What is drawn when its place comes into view, by the id of that place, and what has been.
const waiting = new Map();
const drawn = new Map();
const views = new IntersectionObserver(
  (changes) => {
    for (const { target, isIntersecting } of changes) if (isIntersecting) drawNow(target.id);
  },
  { rootMargin: "200px" },
);

function drawNow(id) {
  const job = waiting.get(id);
  if (!job) return;
  waiting.delete(id);
  views.unobserve(byId(id));
  drawn.set(id, job);
  job();
}

// Draws into a place now if it is in view or has been, else when it comes into view.
export function drawInView(id, job) {
  if (drawn.has(id)) {
    drawn.set(id, job);
    job();
    return;
  }
  waiting.set(id, job);
  views.observe(byId(id));
}

// Draws everything, also what was not in view yet.
export function drawAll() {
  for (const id of [...waiting.keys()]) if (byId(id).offsetWidth) drawNow(id);
  redrawAll();
}

// Draws again what has been drawn, in the colours of now.
export function redrawAll() {
  for (const job of drawn.values()) job();
}

export function startCharts() {
  for (const [id, chart] of Object.entries(report.charts)) drawInView(id, () => draw(id, themed(chart)));
  darkSystem.addEventListener("change", redrawAll);
  startPrinting();
  const choice = byId("theme");
  choice?.addEventListener("change", () => {
    if (choice.value === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = choice.value;
    redrawAll();
  });
}

export const ready = () => {
  document.documentElement.dataset.ready = "yes";
};

// On paper all is light, and as wide as the paper.
function startPrinting() {
  const { dataset } = document.documentElement;
  let theme;
  window.addEventListener("beforeprint", () => {
    theme = dataset.theme;
    dataset.theme = "light";
    dataset.printing = "yes";
    drawAll();
  });
  window.addEventListener("afterprint", () => {
    if (theme) dataset.theme = theme;
    else delete dataset.theme;
    delete dataset.printing;
    redrawAll();
  });
}
