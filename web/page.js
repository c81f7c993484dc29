"use strict";
// The loops on the page: their settings, the picture of the carts, and the plots.

const STEP = 0.001;
const SPAN = 8; // seconds in a plot
const PUSH = 0.1; // duration of a push in seconds
const COLOURS = { Pid: "#2a78d6", PidRbf: "#e0622b", IpidRbf: "#1f9e6e" };
const LABELS = { Pid: "PID", PidRbf: "PID-RBF", IpidRbf: "IPID-RBF" };
const OWN = ["#a08000", "#c2407e", "#4f7f8f", "#9a5fd1"]; // of dropped FMUs
const element = (id) => document.getElementById(id);
const degrees = (radians) => (radians * 180) / Math.PI;
const radians = (degrees) => (degrees * Math.PI) / 180;

// Name, label, unit, minimum, maximum, step, start, and the variable, if it is one of an FMU.
const SETTINGS = [
  ["r", "Set-point", "°", -20, 20, 0.5, 0],
  ["d", "Disturbance of the measurement", "°", -5, 5, 0.1, 0],
  ["push", "Strength of a push of 0.1 s", "N", 1, 150, 1, 60],
  ["delay", "Delay of the measurement", "ms", 0, 30, 1, 0],
  ["kp", "Proportional gain", "N/rad", 0, 1000, 10, 300, "pid.kp"],
  ["ki", "Integral gain", "N/(rad s)", 0, 2000, 10, 500, "pid.ki"],
  ["kd", "Derivative gain", "N s/rad", 0, 300, 1, 100, "pid.kd"],
  ["eta", "Learning rate of the network", "", 0, 2, 0.05, 0.3, "rbf.eta"],
  ["umax", "Limit of the force", "N", 1, 200, 1, 100, "u_max"],
  ["M", "Mass of the cart", "kg", 0.2, 5, 0.001, 1.096, "M"],
  ["m", "Mass of the pendulum", "kg", 0.02, 1, 0.001, 0.109, "m"],
  ["l", "Half the length of the pendulum", "m", 0.1, 1, 0.01, 0.25, "l"],
];
const settings = Object.fromEntries(SETTINGS.map(([name, , , , , , start]) => [name, start]));
Object.assign(settings, { dynamics: "3", on: "Pid,PidRbf", speed: "1" });

const fmus = {};
let loops = [];
let time = 0, running = true, push = 0, pushUntil = 0;
let pushes = []; // the times at which they began

function say(text, isError = false) {
  element("message").textContent = text;
  element("message").className = isError ? "error" : "";
}

function newPlant(state) {
  return new Instance(fmus.Pendulum, (plant) => {
    for (const name of ["M", "m", "l"]) plant.set(name, settings[name]);
    // The inertia of the paper's pendulum, with its mass and length.
    plant.set("I", 0.0034 * (settings.m / 0.109) * (settings.l / 0.25) ** 2);
    plant.setWhole("dynamics", "int64", settings.dynamics);
    for (const name of ["theta", "omega", "x", "v"]) plant.set(`${name}0`, state?.[name] ?? 0);
  });
}

function tune(controller) {
  for (const [name, , , , , , , variable] of SETTINGS) {
    if (variable && controller.fmu.variables[variable]) controller.set(variable, settings[name]);
  }
}

class Loop {
  constructor(name) {
    this.name = name;
    this.colour = COLOURS[name];
    this.plant = newPlant();
    this.controller = new Instance(fmus[name], tune);
    this.measured = [];
    // The time of the plant starts again when the plant is replaced.
    this.time = this.plantTime = 0;
    this.state = { theta: 0, omega: 0, x: 0, v: 0 };
    this.history = [];
    this.swing = 0; // the largest angle since the last push in radians
    this.hasFallen = false;
  }

  step(r, d, force) {
    const { controller, plant } = this;
    const theta = plant.get("theta");
    this.swing = Math.max(this.swing, Math.abs(theta));
    this.hasFallen = this.swing > Math.PI / 2;
    if (this.hasFallen) return;
    this.measured.push(theta);
    while (this.measured.length > settings.delay + 1) this.measured.shift();
    controller.set("r", r);
    const adds = controller.fmu.variables.d; // or the disturbance is in what it measures
    if (adds) controller.set("d", d);
    controller.set("y", this.measured[0] + (adds ? 0 : d));
    controller.step(this.time, STEP);
    const u = controller.get("u");
    plant.set("u", u + force);
    plant.step(this.plantTime, STEP);
    this.time += STEP;
    this.plantTime += STEP;
    this.u = u;
  }

  // Reads what is drawn.
  read(r) {
    for (const name of ["theta", "omega", "x", "v"]) this.state[name] = this.plant.get(name);
    const of = (name) => (this.controller.fmu.variables[name] ? this.controller.getAll(name) : []);
    const { theta } = this.state;
    this.history.push({
      t: time, angle: [degrees(theta)], error: [degrees(r - theta)], force: [this.u ?? 0],
      weights: of("rbf.w"), activations: of("rbf.h"),
    });
    while (this.history[0].t < time - SPAN) this.history.shift();
  }
}

function restart() {
  time = pushUntil = 0;
  pushes = [];
  say("");
  loops = settings.on.split(",").filter((name) => fmus[name]).flatMap((name) => {
    try {
      return new Loop(name);
    } catch (error) {
      say(`${name} cannot start: ${error.message}`, true);
      return [];
    }
  });
  for (const loop of loops) loop.read(radians(settings.r));
  element("effect").replaceChildren(...loops.map(swingOf));
}

// Advances all loops; one that fails is taken out, and its error shown.
function advance(steps) {
  const [r, d] = [radians(settings.r), radians(settings.d)];
  for (let i = 0; i < steps; i++) {
    const force = time < pushUntil ? push : 0;
    for (const loop of [...loops]) {
      try {
        loop.step(r, d, force);
      } catch (error) {
        say(`${loop.name} stopped at ${time.toFixed(3)} s: ${error.message}`, true);
        loops.splice(loops.indexOf(loop), 1);
      }
    }
    time += STEP;
  }
  for (const loop of loops.filter(({ hasFallen }) => !hasFallen)) loop.read(r);
}

// A row that says how far the pendulum of a loop has swung since the last push.
function swingOf({ name, colour }) {
  const row = document.createElement("div");
  row.className = "swing";
  row.innerHTML = "<span></span><i></i><span></span>";
  row.firstChild.textContent = LABELS[name] ?? name;
  row.children[1].style.background = colour;
  return row;
}

function compare() {
  const none = loops.length > 0 && loops.every(({ hasFallen }) => hasFallen);
  element("swung").textContent = none ? "All fell over: Reset sets them up again" : "Largest angle since the last push";
  const largest = Math.max(...loops.map(({ swing }) => swing), 1e-9);
  loops.forEach(({ swing, hasFallen }, i) => {
    const [, bar, text] = element("effect").children[i].children;
    bar.style.width = `${(100 * swing) / largest}%`;
    text.textContent = hasFallen ? "fell over" : `${degrees(swing).toFixed(2)}°`;
  });
}

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
  if (pushes.length && time < pushes.at(-1) + 4 * PUSH) {
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
  const all = curves.flatMap((rows) => rows.flatMap((row) => row[id]));
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
  if (!all.length) c.fillText("No network among the controllers", width / 2, height / 2);
  c.lineWidth = 1.5;
  loops.forEach((loop, k) => {
    c.strokeStyle = loop.colour;
    for (let i = 0; i < (curves[k].at(-1)?.[id].length ?? 0); i++) {
      c.beginPath();
      for (const row of curves[k]) c.lineTo(x(row.t), y(row[id][i] ?? 0));
      c.stroke();
    }
  });
}

function draw() {
  drawScene();
  for (const id of ["angle", "error", "force", "weights", "activations"]) drawPlot(id);
  compare();
  element("time").textContent = `${time.toFixed(2)} s`;
}

let last, left = 0;
function frame(now) {
  // After a pause of the browser, the loops go on from where they were.
  left += running ? Math.min((now - (last ?? now)) / 1000, 0.05) * settings.speed : 0;
  last = now;
  const steps = Math.floor(left / STEP);
  left -= steps * STEP;
  if (steps) advance(steps);
  draw();
  requestAnimationFrame(frame);
}

function shove(force) {
  push = force;
  pushUntil = time + PUSH;
  pushes = [...pushes.filter((t) => t > time - SPAN), time];
  for (const loop of loops) loop.swing = 0;
}

function remember() {
  history.replaceState(null, "", `#${new URLSearchParams(settings)}`);
}

// Changes a setting. What is fixed in the plant needs a new one, in the same state.
function change(name, value) {
  settings[name] = value;
  remember();
  try {
    for (const loop of loops) {
      if (["M", "m", "l", "dynamics"].includes(name)) {
        loop.plant = newPlant(loop.state);
        loop.plantTime = 0;
      } else {
        tune(loop.controller);
      }
    }
  } catch (error) {
    say(error.message, true);
  }
}

function addController(name) {
  const label = document.createElement("label");
  label.className = "controller";
  label.innerHTML = '<input type="checkbox"> <span class="key"></span>';
  const box = label.querySelector("input");
  box.id = `on-${name}`;
  box.checked = settings.on.split(",").includes(name);
  COLOURS[name] ??= OWN[Object.keys(COLOURS).length % OWN.length];
  label.querySelector(".key").style.background = COLOURS[name];
  label.append(LABELS[name] ?? name);
  box.onchange = () => {
    const all = document.querySelectorAll("#controllers input:checked");
    settings.on = [...all].map((node) => node.id.slice(3)).join(",");
    remember();
    restart();
  };
  element("controllers").append(label);
  return box;
}

async function take(file) {
  try {
    const fmu = await readFmu(new Uint8Array(await file.arrayBuffer()));
    for (const [name, causality] of [["r", "input"], ["y", "input"], ["u", "output"]]) {
      if (fmu.variables[name]?.causality !== causality) throw new Error(`it has no ${causality} ${name}`);
    }
    // The plant keeps its FMU, and a comma separates names in the settings.
    const isTaken = fmu.name in LABELS || fmu.name === "Pendulum";
    const name = (isTaken ? `${fmu.name} (yours)` : fmu.name).replaceAll(",", ";");
    fmus[name] = fmu;
    const box = element(`on-${name}`) ?? addController(name);
    box.checked = true;
    box.onchange();
    shove(settings.push);
    if (loops.some((loop) => loop.name === name)) say(`${name} runs.`);
  } catch (error) {
    say(`${file.name} cannot be used: ${error.message}`, true);
  }
}

function addDownload(name, bytes) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([bytes]));
  link.download = `${name}_fmi3.fmu`;
  link.textContent = name;
  element("downloads").append(link, " ");
}

function addSlider([name, label, unit, min, max, step]) {
  const node = document.createElement("label");
  node.className = "slider";
  node.innerHTML = '<span></span><span class="value"></span><input type="range">';
  const [text, shown, input] = node.children;
  text.textContent = label;
  Object.assign(input, { id: name, min, max, step, value: settings[name] });
  const show = () => {
    shown.textContent = `${+input.value} ${unit}`;
    input.setAttribute("aria-valuetext", shown.textContent);
  };
  input.oninput = () => {
    show();
    change(name, +input.value);
  };
  show();
  element("sliders").append(node);
}

function go(on) {
  running = on;
  element("run").textContent = running ? "Pause" : "Run";
}

function bind() {
  element("run").onclick = () => go(!running);
  element("once").onclick = () => {
    go(false);
    advance(1);
  };
  element("reset").onclick = restart;
  element("left").onclick = () => shove(-settings.push);
  element("right").onclick = () => shove(settings.push);
  for (const name of ["speed", "dynamics"]) {
    element(name).value = settings[name];
    element(name).onchange = () => change(name, element(name).value);
  }
  element("defaults").onclick = () => {
    for (const [name, , , , , , start] of SETTINGS) {
      element(name).value = start;
      element(name).oninput();
    }
    element("dynamics").value = "3";
    change("dynamics", "3");
  };
  // It pushes the cart from the side of the click.
  element("scene").onclick = ({ clientX, target }) => {
    const { left, width } = target.getBoundingClientRect();
    shove(clientX < left + width / 2 ? settings.push : -settings.push);
  };
  addEventListener("keydown", (event) => {
    const { key, target, altKey, ctrlKey, metaKey } = event;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[key];
    if (!way || altKey || ctrlKey || metaKey || target.matches("input, select")) return;
    event.preventDefault();
    shove(way * settings.push);
  });
  // Another address, entered on the page
  addEventListener("hashchange", () => location.reload());
  element("file").onchange = () => element("file").files[0] && take(element("file").files[0]);
  const mark = (on) => document.body.classList.toggle("drag", on);
  addEventListener("dragover", (event) => {
    event.preventDefault();
    mark(true);
  });
  addEventListener("dragleave", (event) => event.relatedTarget ?? mark(false));
  addEventListener("drop", (event) => {
    event.preventDefault();
    mark(false);
    const [file] = event.dataTransfer.files;
    if (file) take(file);
  });
}

async function start() {
  for (const [name, value] of new URLSearchParams(location.hash.slice(1))) {
    const known = SETTINGS.find(([setting]) => setting === name);
    if (known && value.trim() && +value >= known[3] && +value <= known[4]) settings[name] = +value;
    const choices = [...(element(name)?.options ?? [])].map((option) => option.value);
    if (name === "on" || choices.includes(value)) settings[name] = value;
  }
  const packed = JSON.parse(element("fmus").textContent);
  for (const [name, text] of Object.entries(packed)) {
    fmus[name] = await readFmu(unpacked(text));
  }
  for (const name of Object.keys(COLOURS)) addController(name);
  for (const [name, text] of Object.entries(packed)) addDownload(name, unpacked(text));
  SETTINGS.forEach(addSlider);
  for (const plot of document.querySelectorAll(".plot")) {
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", plot.previousSibling.textContent);
  }
  bind();
  restart();
  go(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  shove(settings.push);
  requestAnimationFrame(frame);
}

start().catch((error) => say(error.message, true));
