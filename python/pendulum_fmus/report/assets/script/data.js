// The data in the page: columns of numbers, styles, and the colours of the reader's scheme.
const { columns, panels, styles } = JSON.parse(document.getElementById("data").textContent);

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const doubles = (text) => new Float64Array(bytes(text));

const unpack = ({ x, y }) => ({ x: doubles(x), y: doubles(y) });

const unpacked = new Map();
function column(key) {
  if (!unpacked.has(key)) unpacked.set(key, unpack(columns[key]));
  return unpacked.get(key);
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
