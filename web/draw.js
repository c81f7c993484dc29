"use strict";
// The picture of the carts, and the plots.

function canvas(id) {
  const node = element(id);
  const { clientWidth: width, clientHeight: height } = node;
  const scale = devicePixelRatio || 1;
  if (node.width !== Math.round(width * scale)) [node.width, node.height] = [width * scale, height * scale];
  const c = node.getContext("2d");
  c.setTransform(scale, 0, 0, scale, 0, 0);
  c.clearRect(0, 0, width, height);
  c.font = "12px system-ui, sans-serif";
  return { c, width, height };
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function drawScene() {
  const { c, width, height } = canvas("scene");
  const metre = Math.min((0.68 * height) / (2 * settings.l), width / 1.6);
  const ground = height - 22;
  const [cart, wheel, half] = [0.06, 0.016, 0.09].map((length) => length * metre);
  const pivot = ground - 2 * wheel - cart;
  // The picture follows the first cart whose pendulum stands.
  const centre = (loops.find(({ hasFallen }) => !hasFallen) ?? loops[0])?.state.x ?? 0;
  c.strokeStyle = c.fillStyle = colour("--soft");
  c.lineWidth = 1;
  c.beginPath();
  c.moveTo(0, ground);
  c.lineTo(width, ground);
  c.textAlign = "center";
  const tick = ticksOf(0, width / metre, width / 80).step;
  for (let n = Math.ceil((centre - width / 2 / metre) / tick); n * tick < centre + width / 2 / metre; n++) {
    const at = width / 2 + (n * tick - centre) * metre;
    c.moveTo(at, ground);
    c.lineTo(at, ground + 5);
    if (at > 20 && at < width - 20) c.fillText(`${+(n * tick).toFixed(2)} m`, at, ground + 17);
  }
  c.stroke();
  c.textAlign = "left";
  for (const [i, loop] of [...loops.entries()].reverse()) {
    const at = width / 2 + (loop.state.x - centre) * metre;
    const [up, side] = [Math.cos(loop.state.theta), Math.sin(loop.state.theta)].map((part) => 2 * settings.l * metre * part);
    c.globalAlpha = i ? 0.75 : 1;
    c.fillStyle = c.strokeStyle = loop.colour;
    c.fillRect(at - half, pivot, 2 * half, cart);
    for (const place of [at - half / 2, at + half / 2]) {
      c.beginPath();
      c.arc(place, ground - wheel, wheel, 0, 7);
      c.fill();
    }
    c.lineWidth = 7;
    c.lineCap = "round";
    c.beginPath();
    c.moveTo(at, pivot);
    c.lineTo(at + side, pivot - up);
    c.stroke();
    // A cart beside the picture
    const away = `${LABELS[loop.name] ?? loop.name} ${Math.abs(loop.state.x - centre).toFixed(1)} m`;
    if (at < -half) c.fillText(`◀ ${away}`, 4, 20 + 18 * i);
    if (at > width + half) c.fillText(`${away} ▶`, width - 4 - c.measureText(`${away} ▶`).width, 20 + 18 * i);
  }
  c.globalAlpha = 1;
  if (pushes.length && time < pushes.at(-1) + PUSH + 0.3) {
    c.fillStyle = colour("--text");
    c.font = "600 15px system-ui, sans-serif";
    c.textAlign = push > 0 ? "right" : "left";
    c.fillText(push > 0 ? "push ▶" : "◀ push", width / 2 - Math.sign(push) * (half + 12), ground - 10);
  }
}

// Round numbers in a range, a few: their distance, the first and the last as its multiples.
function ticksOf(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((n) => n * power).find((size) => size >= rough);
  return { step, first: Math.ceil(low / step - 1e-6), last: Math.floor(high / step + 1e-6) };
}

function drawPlot(id) {
  const { c, width, height } = canvas(id);
  const start = Math.max(0, time - SPAN), bottom = height - 20;
  const curves = loops.map(({ history }) => history.filter(({ t }) => t >= start));
  const setPoints = id === "angle" ? curves[0]?.map((row) => [row.t, row.angle[0] + row.error[0]]) ?? [] : [];
  const all = curves.flatMap((rows) => rows.flatMap((row) => row[id])).concat(setPoints.map(([, r]) => r));
  let [low, high] = [Math.min(0, ...all), Math.max(0, ...all)];
  if (high - low < 1e-9) [low, high] = [-1, 1];
  const x = (t) => 48 + ((t - start) / SPAN) * (width - 52);
  const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - 8);
  c.fillStyle = c.strokeStyle = colour("--line");
  for (const t of pushes) c.fillRect(Math.max(48, x(t)), 8, x(t + PUSH) - x(t), bottom - 8);
  const rows = ticksOf(low, high, 4);
  c.beginPath();
  for (let n = rows.first; n <= rows.last; n++) {
    c.moveTo(48, y(n * rows.step));
    c.lineTo(width, y(n * rows.step));
  }
  c.stroke();
  c.fillStyle = colour("--soft");
  c.textAlign = "right";
  for (let n = rows.first; n <= rows.last; n++) c.fillText(+(n * rows.step).toPrecision(3), 42, y(n * rows.step) + 4);
  c.textAlign = "center";
  for (let t = 2 * Math.ceil(start / 2); t < start + SPAN; t += 2) c.fillText(`${t} s`, Math.max(56, x(t)), height - 4);
  if (!all.length) c.fillText(loops.length ? "No network among the controllers" : "No controller", width / 2, height / 2);
  c.lineWidth = 1.5;
  c.strokeStyle = c.fillStyle;
  c.setLineDash([5, 4]);
  c.beginPath();
  for (const [t, r] of setPoints) c.lineTo(x(t), y(r));
  c.stroke();
  c.setLineDash([]);
  loops.forEach((loop, k) => {
    c.strokeStyle = loop.colour;
    for (let i = 0; i < (curves[k].at(-1)?.[id].length ?? 0); i++) {
      c.beginPath();
      for (const row of curves[k]) c.lineTo(x(row.t), y(row[id][i] ?? 0));
      c.stroke();
    }
  });
}
