// The curves of a panel: their lines and markers, and the frame of the magnified part.
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
