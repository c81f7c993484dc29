// Draws all panels soon after the page has opened, and again when its size or colours change.
const SLICE = 12; // [ms] of drawing between two chances for the page to react
const elements = [...document.querySelectorAll(".drawing")];

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });
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

// Returns the plots whose elements have another size, with that size.
function outgrown() {
  const all = elements.map((element) => [element.plot, sizeOf(element)]);
  return all.filter(([plot, size]) => plot.width !== size.width || plot.height !== size.height);
}

const fit = ([plot, size]) => plot.setSize(size);

function recolour() {
  colours = null;
  return inSlices(elements, (element) => element.plot.redraw(false));
}

function reprint() {
  colours = null;
  outgrown().forEach(fit);
  for (const element of elements) element.plot.redraw(false);
}

// Long tables are folded on a narrow screen, and none on paper.
const long = [...document.querySelectorAll(".table-of")];
if (innerWidth < 700) long.forEach((table) => (table.open = false));
addEventListener("beforeprint", () => long.forEach((table) => (table.open = true)));

let timer;
const resized = new ResizeObserver(() => {
  clearTimeout(timer);
  timer = setTimeout(() => inSlices(outgrown(), fit), 100);
});

async function first() {
  const found = elements.map((element, k) => [element, panels[k], sizeOf(element)]);
  await inSlices(found, ([element, panel, size]) => {
    element.plot = draw(element, panel, size);
  });
  for (const element of elements) resized.observe(element);
  dark.addEventListener("change", recolour);
  printing.addEventListener("change", reprint);
  document.body.dataset.drawn = document.querySelectorAll("figure .plot").length;
}

first();
