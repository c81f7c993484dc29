// The data in the page: columns of numbers, styles, and the colours of the reader's scheme.
const { clocks, columns, panels, styles } = JSON.parse(document.getElementById("data").textContent);

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const doubles = (text) => new Float64Array(bytes(text));
const times = clocks.map(doubles);

function unpack({ clock, at, y }) {
  const x = Float64Array.from(new Uint32Array(bytes(at)), (k) => times[clock][k]);
  return { x, y: doubles(y) };
}

const unpacked = new Map();
function column(number) {
  if (!unpacked.has(number)) unpacked.set(number, unpack(columns[number]));
  return unpacked.get(number);
}

const dark = matchMedia("(prefers-color-scheme: dark)");
const printing = matchMedia("print");

let colours = null;
function palette() {
  if (!colours) {
    const css = getComputedStyle(document.documentElement);
    const names = ["ink", "soft", "line", "grid", "card"];
    colours = Object.fromEntries(names.map((name) => [name, css.getPropertyValue(`--${name}`)]));
    colours.name = dark.matches && !printing.matches ? "dark" : "light";
  }
  return colours;
}

const subscript = (text) => text.replaceAll("u_n", "uₙ").replaceAll("u_p", "uₚ");
