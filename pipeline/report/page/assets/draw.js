// Draws charts in the colours of the theme, each when it comes into view.

export const report = JSON.parse(document.getElementById("report").textContent);
export const byId = (id) => document.getElementById(id);
const root = document.documentElement;
const darkSystem = window.matchMedia("(prefers-color-scheme: dark)");

export const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : darkSystem.matches);

// What a colour such as var(--ink) is under the theme of now.
export function paint(colour) {
  const name = /^var\((--\w+)\)$/.exec(colour);
  return name ? getComputedStyle(root).getPropertyValue(name[1]).trim() : colour;
}

// A copy of a chart in the colours of now; only what is named a colour is one, so that no name of a pair is.
const themed = (chart) =>
  JSON.parse(JSON.stringify(chart), (key, value) =>
    key.endsWith("color") ? (Array.isArray(value) ? value.map(paint) : paint(value)) : value,
  );

const resizes = new ResizeObserver((changes) => {
  for (const { target } of changes) {
    const { offsetWidth: width, offsetHeight: height, _fullLayout: now } = target;
    if (width && (width !== now.width || height !== now.height)) Plotly.relayout(target, { width, height });
  }
});

// Draws or redraws a chart. It follows the size of its container, also if that was hidden meanwhile.
export function draw(id, { data, layout }, config = {}) {
  // Buttons are listed one by one: plotly's own choice includes one that uploads the chart.
  const modeBarButtons = [["toImage"]];
  const shared = { displaylogo: false, displayModeBar: false, modeBarButtons, plotlyServerURL: "" };
  const place = byId(id);
  const size = { width: place.offsetWidth, height: place.offsetHeight };
  Plotly.react(id, data, { ...size, ...layout, template: themed(report.template) }, { ...shared, ...config });
  resizes.observe(place);
}

// How each place is drawn, by its id, and which ones have been.
const jobs = new Map();
const drawn = new Set();
const watch = (threshold, rootMargin) =>
  new IntersectionObserver(
    (changes) => {
      for (const { target, isIntersecting, intersectionRatio } of changes)
        if (isIntersecting && intersectionRatio >= threshold) drawNow(target.id);
    },
    { threshold, rootMargin },
  );
const views = watch(0, "200px");
// WebGL takes seconds without a graphics card: a scene is a line high until it is in view.
const scenes = watch(1 / 3, "0px");
const observerOf = (place) => (place.matches(".scene") ? scenes : views);

function drawNow(id) {
  observerOf(byId(id)).unobserve(byId(id));
  drawn.add(id);
  byId(id).classList.add("drawn");
  jobs.get(id)();
}

// Draws into a place now if it is in view or has been, else when it comes into view.
export function drawInView(id, job) {
  jobs.set(id, job);
  if (drawn.has(id)) job();
  else observerOf(byId(id)).observe(byId(id));
}

// Draws again, in the colours of now, what has been drawn.
function redraw() {
  for (const id of drawn) jobs.get(id)();
}

// Follows the theme and the printer, hints at wide tables, and says that the page is complete.
export function start() {
  const choice = byId("theme");
  const setTheme = (theme) => {
    if (theme === "auto") delete root.dataset.theme;
    else root.dataset.theme = theme;
  };
  choice.addEventListener("change", () => {
    setTheme(choice.value);
    redraw();
  });
  darkSystem.addEventListener("change", redraw);
  // On paper all is light, and as wide as the paper.
  window.addEventListener("beforeprint", () => {
    setTheme("light");
    root.dataset.printing = "yes";
    for (const id of jobs.keys()) if (byId(id).offsetWidth) drawNow(id);
    // A browser prints the last frame of WebGL, which is that of the screen: paper has a picture of the next one.
    for (const { _fullLayout: layout } of document.querySelectorAll(".js-plotly-plot")) {
      const plot = layout.scene?._scene?.glplot;
      plot?.redraw();
      if (!plot?.canvas.width) continue;
      const picture = plot.canvas.cloneNode();
      picture.className = "printed";
      picture.getContext("2d").drawImage(plot.canvas, 0, 0);
      plot.canvas.after(picture);
    }
  });
  window.addEventListener("afterprint", () => {
    for (const picture of document.querySelectorAll("canvas.printed")) picture.remove();
    setTheme(choice.value);
    delete root.dataset.printing;
    redraw();
  });
  for (const { nextElementSibling: box } of document.querySelectorAll(".scroll"))
    for (const one of [box, box.firstElementChild]) widths.observe(one);
  root.dataset.ready = "yes";
}

// Hints at columns on the right above each table that is wider than its place.
const widths = new ResizeObserver((changes) => {
  for (const { target } of changes) {
    const box = target.closest(".wide");
    box.previousElementSibling.hidden = box.scrollWidth <= box.clientWidth + 2;
  }
});
