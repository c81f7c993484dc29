// Draws all panels soon after the page has opened, and again when its size or colours change.
const SLICE = 12; // [ms] of drawing between two chances for the page to react
const elements = [...document.querySelectorAll(".drawing")];

const pause = () => new Promise((done) => setTimeout(done));

async function inSlices(list, action) {
  let start = performance.now();
  for (const one of list) {
    action(one);
    if (performance.now() - start < SLICE) continue;
    await pause();
    start = performance.now();
  }
}

function fit(element) {
  const { width, height } = sizeOf(element), plot = element.plot;
  if (plot.width !== width || plot.height !== height) plot.setSize({ width, height });
}

function recolour() {
  colours = null;
  return inSlices(elements, (element) => element.plot?.redraw(false));
}

function reprint() {
  colours = null;
  for (const element of elements) {
    fit(element);
    element.plot.redraw(false);
  }
}

let timer;
const resized = new ResizeObserver(() => {
  clearTimeout(timer);
  timer = setTimeout(() => inSlices(elements, fit), 100);
});

async function first() {
  await inSlices(elements, (element) => {
    element.plot = draw(element, panels[elements.indexOf(element)]);
  });
  for (const element of elements) resized.observe(element);
  dark.addEventListener("change", recolour);
  printing.addEventListener("change", reprint);
  document.body.dataset.drawn = document.querySelectorAll("figure .plots").length;
}

first();
