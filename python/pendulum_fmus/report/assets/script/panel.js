// One panel: its curves drawn with uPlot, with markers, a frame, a readout and zoom.
const TICK = 11, ROOM = { x: 62, y: 26 };

const FONT = `${TICK}px ${getComputedStyle(document.body).fontFamily}`;
const measure = document.createElement("canvas").getContext("2d");
measure.font = FONT;

// Paths of markers around the origin, of about the same area.
const MARKERS = {
  o: (path, r) => path.arc(0, 0, r, 0, 2 * Math.PI),
  s: (path, r) => path.rect(-0.9 * r, -0.9 * r, 1.8 * r, 1.8 * r),
  "^": (path, r) => polygon(path, [[0, -1.2 * r], [1.1 * r, 0.8 * r], [-1.1 * r, 0.8 * r]]),
  D: (path, r) => polygon(path, [[0, -1.25 * r], [1.25 * r, 0], [0, 1.25 * r], [-1.25 * r, 0]]),
};

function polygon(path, corners) {
  corners.forEach(([x, y], k) => (k ? path.lineTo(x, y) : path.moveTo(x, y)));
  path.closePath();
}

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

// The end `a` of a line to `b`, moved along it to heights of at least `low` and at most `high`.
function nearer(a, b, low, high) {
  const y = Math.min(Math.max(a.y, low), high);
  return y === a.y ? a : { x: a.x + ((b.x - a.x) * (y - a.y)) / (b.y - a.y), y };
}

// The line through a curve's own samples. Parts far off the panel are left out: a spike of a
// thousand times its height would have as many dashes.
function pathOf(u, curve) {
  const stroke = new Path2D(), { left, top, width, height } = u.bbox;
  const low = top - height, high = top + 2 * height;
  const outside = (a, b) =>
    Math.max(a.x, b.x) < left || Math.min(a.x, b.x) > left + width
    || Math.max(a.y, b.y) < low || Math.min(a.y, b.y) > high;
  let before = null, pen = null;
  curve.x.forEach((_, k) => {
    const x = u.valToPos(curve.x[k], "x", true), y = u.valToPos(curve.y[k], "y", true);
    const now = { x, y };
    if (before && !outside(before, now)) {
      const start = nearer(before, now, low, high), end = nearer(now, before, low, high);
      if (start !== pen) stroke.moveTo(start.x, start.y);
      stroke.lineTo(end.x, end.y);
      pen = end;
    }
    before = now;
  });
  return { stroke, fill: null, clip: null, band: null, gaps: null, flags: 1 };
}

// The options of uPlot for a panel that shows the ranges in `view`.
function options(panel, view, curves, size, actions) {
  const scale = (key, log) => ({
    time: false, auto: false, distr: log ? 3 : 1, range: () => view[key],
  });
  const series = curves.map((curve) => ({
    paths: (u) => pathOf(u, curve), stroke: () => styles[curve.style][palette().name], width: styles[curve.style].width,
    dash: styles[curve.style].dash.map((part) => part * devicePixelRatio),
    points: { show: false },
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

// Draws the markers and the frame of the part that another panel magnifies.
function drawExtras(u, panel, curves) {
  const { ctx, bbox } = u, colours = palette();
  const place = (x, y) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.setLineDash([]);
  ctx.lineWidth = 1.3 * devicePixelRatio;
  ctx.fillStyle = colours.card;
  for (const { style, x, y, marks } of curves) {
    ctx.strokeStyle = styles[style][colours.name];
    for (const k of marks) drawMarker(ctx, styles[style].marker, place(x[k], y[k]));
  }
  if (panel.frame) {
    const [[left, right], [bottom, top]] = panel.frame;
    const [x0, y0] = place(left, top), [x1, y1] = place(right, bottom);
    ctx.strokeStyle = colours.soft;
    ctx.lineWidth = devicePixelRatio;
    ctx.strokeRect(x0, y0, x1 - x0, y1 - y0);
  }
  ctx.restore();
}

function drawMarker(ctx, marker, [x, y]) {
  ctx.save();
  ctx.translate(x, y);
  ctx.beginPath();
  MARKERS[marker](ctx, 3.2 * devicePixelRatio);
  ctx.fill();
  ctx.stroke();
  ctx.restore();
}

// The sample of any curve nearest to the cursor, within 40 pixels.
function nearest(u, curves) {
  const { left, top } = u.cursor;
  let found = null, least = 40;
  for (const curve of curves) {
    const at = u.posToVal(left, "x");
    const after = curve.x.findIndex((x) => x >= at);
    for (const k of after < 0 ? [curve.x.length - 1] : [after - 1, after]) {
      if (k < 0) continue;
      const x = u.valToPos(curve.x[k], "x"), y = u.valToPos(curve.y[k], "y");
      const distance = Math.hypot(x - left, y - top);
      if (distance < least) [found, least] = [{ curve, k, x, y }, distance];
    }
  }
  return found;
}

// Returns a function that shows the numbers at the cursor.
function reader(element, panel, curves) {
  const readout = element.appendChild(document.createElement("output"));
  const named = (label, value) => `${label.replace(/ \[.*/, "")} = ${minus(String(value))}`;
  readout.hidden = true;
  return (u) => {
    const found = u.cursor.left >= 0 && nearest(u, curves);
    readout.hidden = !found;
    if (!found) return;
    const { curve, k, x, y } = found, right = x > u.over.clientWidth / 2;
    const value = named(panel.yLabel, curve.y[k]), where = named(panel.xLabel, curve.x[k]);
    readout.textContent = `${subscript(curve.name)}\n${where}\n${value}`;
    readout.style.left = `${u.over.offsetLeft + x}px`;
    readout.style.top = `${u.over.offsetTop + y}px`;
    readout.className = right ? "readout before" : "readout";
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

