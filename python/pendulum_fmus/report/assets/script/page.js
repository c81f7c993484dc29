// Draws the panels that are shown, soon after the page has opened or a part has been unfolded, and again when their size
// or colours change.
const SLICE = 12; // [ms] of drawing between two chances for the page to react
const elements = [...document.querySelectorAll(".drawing")];

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });
const pause = () => new Promise((done) => setTimeout(done));

// Draws a panel, or fits it to the size of its element.
function fit(element) {
  const size = sizeOf(element), { plot } = element;
  if (!plot) element.plot = draw(element, panels[elements.indexOf(element)], size);
  else if (plot.width !== size.width || plot.height !== size.height) plot.setSize(size);
}

const shownNow = () => elements.filter((element) => element.checkVisibility());

async function inSlices(list, action) {
  let start = performance.now();
  for (const one of list) {
    action(one);
    if (performance.now() - start < SLICE) continue;
    await pause();
    start = performance.now();
  }
}

async function fitAll() {
  await inSlices(shownNow(), fit);
  document.body.dataset.drawn = elements.filter((element) => element.plot).length;
}

function recolour() {
  colours = null;
  return inSlices(elements.filter((element) => element.plot), ({ plot }) => plot.redraw(false));
}

function reprint() {
  colours = null;
  shownNow().forEach(fit);
  for (const { plot } of elements) plot?.redraw(false);
}

// Nothing is folded on paper.
addEventListener("beforeprint", () => {
  for (const part of document.querySelectorAll("main details")) part.open = true;
  reprint();
});

// A link into a folded part unfolds it.
function unfoldTarget() {
  const target = document.getElementById(location.hash.slice(1));
  for (let part = target; part; part = part.parentElement?.closest("details")) {
    if (part.tagName === "DETAILS") part.open = true;
  }
  target?.scrollIntoView();
}
addEventListener("hashchange", unfoldTarget);
if (location.hash) unfoldTarget();

let timer;
const resized = new ResizeObserver(() => {
  clearTimeout(timer);
  timer = setTimeout(fitAll, 30);
});
for (const element of elements) resized.observe(element);
dark.addEventListener("change", recolour);
printing.addEventListener("change", reprint);
