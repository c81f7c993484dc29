// One panel: its axes and curves drawn with uPlot, and zoom.
const TICK = 11, ROOM = { x: 62, y: 26 };

const FONT = `${TICK}px ${getComputedStyle(document.body).fontFamily}`;
const measure = document.createElement("canvas").getContext("2d");
measure.font = FONT;

function axis(key, log) {
  let ticks = [];
  const color = (name) => () => palette()[name];
  const length = (u) => (key === "x" ? u.bbox.width : u.bbox.height) / devicePixelRatio;
  return {
    scale: key, side: key === "x" ? 2 : 3, font: FONT, gap: 4, stroke: color("soft"),
    grid: { stroke: color("grid"), width: 1 },
    ticks: { stroke: color("line"), width: 1, size: 4 },
    border: { show: true, stroke: color("line"), width: 1 },
    splits: (u, _, low, high) => {
      ticks = ticksOf(low, high, log, length(u), ROOM[key]);
      return ticks.map((tick) => tick.at);
    },
    filter: (u, splits) => splits,
    values: () => ticks.map((tick) => tick.text),
    size: (u, texts) => (key === "x" ? TICK + 15 : 14 + widest(texts)),
  };
}

const widest = (texts) =>
  Math.max(24, ...(texts ?? []).map((text) => measure.measureText(text).width));

// The options of uPlot for a panel that shows the ranges in `view`.
function options(panel, view, curves, size, actions) {
  const scale = (key, log) => ({
    time: false, auto: false, distr: log ? 3 : 1, range: () => view[key],
  });
  const series = curves.map((curve) => ({
    paths: (u) => pathOf(u, curve), points: { show: false },
    stroke: () => styles[curve.style][palette().name], width: styles[curve.style].width,
    dash: styles[curve.style].dash.map((part) => part * devicePixelRatio),
  }));
  return {
    ...size, padding: [8, 18, 0, 0], legend: { show: false },
    scales: { x: scale("x", panel.logX), y: scale("y", panel.logY) },
    axes: [axis("x", panel.logX), axis("y", panel.logY)],
    series: [{}, ...series],
    cursor: {
      drag: { x: true, y: true, uni: 16, setScale: false }, points: { show: false },
      bind: { dblclick: () => actions.reset },
    },
    hooks: {
      draw: [(u) => drawExtras(u, panel, curves)],
      setSelect: [actions.zoom], setCursor: [actions.read],
    },
  };
}

// The ranges of all samples.
function everything(panel, curves) {
  const range = (key, log) => {
    const all = curves.flatMap((curve) => [...curve[key]]).filter((value) => !log || value > 0);
    return [Math.min(...all), Math.max(...all)];
  };
  return { x: range("x", panel.logX), y: range("y", panel.logY) };
}

// Draws a panel in its element, of the given size; returns the plot.
function draw(element, panel, size) {
  const view = { x: panel.x, y: panel.y };
  const curves = panel.curves.map((curve) => ({ ...curve, ...column(curve.column) }));
  const show = (u) =>
    u.batch(() => {
      for (const key of ["x", "y"]) {
        u.setScale(key, { min: view[key][0], max: view[key][1] });
      }
    });
  const actions = {
    read: reader(element, panel, curves),
    reset: () => {
      const zoomed = view.x !== panel.x || view.y !== panel.y;
      Object.assign(view, zoomed ? { x: panel.x, y: panel.y } : everything(panel, curves));
      show(plot);
    },
    zoom: (u) => {
      const { left, top, width, height } = u.select;
      if (width < 4 || height < 4) return;
      view.x = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
      view.y = [u.posToVal(top + height, "y"), u.posToVal(top, "y")];
      u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      show(u);
    },
  };
  const data = [panel.x, ...curves.map(() => panel.y)]; // as each curve has its own samples
  const plot = new uPlot(options(panel, view, curves, size, actions), data, element);
  plot.curves = curves;
  return plot;
}
