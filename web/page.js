"use strict";
// The loops on the page, and its controls.

const STEP = 0.001;
const SPAN = 8; // seconds in a plot
const PUSH = 0.3; // duration of a push in seconds
const SETTLE = 4; // seconds that the loops get to reach a set-point before the first push
const COLOURS = { Pid: "#2a78d6", PidRbf: "#e0622b", IpidRbf: "#1f9e6e" };
const LABELS = { Pid: "PID", PidRbf: "PID-RBF", IpidRbf: "IPID-RBF" };
const OWN = ["#a08000", "#c2407e", "#4f7f8f", "#9a5fd1"]; // of dropped FMUs
const element = (id) => document.getElementById(id);
const degrees = (radians) => (radians * 180) / Math.PI;
const radians = (degrees) => (degrees * Math.PI) / 180;

const fmus = {};
let loops = [];
let time = 0, running = true, push = 0, pushUntil = 0, tellAt = Infinity;
let pushes = []; // the times at which they began

// The page is still until somebody presses Run.
const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;

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
    this.largestError = 0; // since the last push in radians
    this.hasFallen = false;
  }

  step(r, d, force) {
    if (this.hasFallen) return;
    const { controller, plant } = this;
    const theta = plant.get("theta");
    this.largestError = Math.max(this.largestError, Math.abs(r - theta));
    this.hasFallen = Math.abs(theta) > Math.PI / 2;
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
  tellAt = Infinity;
  pushes = [];
  say("");
  loops = settings.on.split(",").filter(Boolean).flatMap((name) => {
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

// Starts the loops, lets them settle, and pushes the carts.
function begin() {
  restart();
  if (settings.r || settings.d) pass(SETTLE);
  shove(settings.push);
}

// Computes a time at once, with as many points in the plots as in frames.
function pass(seconds) {
  for (let frames = Math.round(seconds / STEP / 20); frames > 0; frames--) advance(20);
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
        element("effect").children[loops.indexOf(loop)].remove();
        loops.splice(loops.indexOf(loop), 1);
      }
    }
    time += STEP;
  }
  for (const loop of loops.filter(({ hasFallen }) => !hasFallen)) loop.read(r);
}

// A row that says how far the pendulum of a loop has been from its set-point since the last push.
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
  const title = none ? "All fell over: Reset sets them up again" : `Largest control error since the ${pushes.length ? "last push" : "start"}`;
  element("swung").textContent = loops.length ? title : "No controller: choose one, or drop an FMU";
  const largest = Math.max(...loops.map(({ largestError }) => largestError), 1e-9);
  loops.forEach(({ largestError, hasFallen }, i) => {
    const [, bar, text] = element("effect").children[i].children;
    bar.style.width = `${(100 * largestError) / largest}%`;
    text.textContent = hasFallen ? "fell over" : `${degrees(largestError).toFixed(2)}°`;
  });
  if (time < tellAt) return;
  tellAt = Infinity;
  const rows = [...element("effect").children].map((row) => `${row.firstChild.textContent} ${row.lastChild.textContent}`);
  element("told").textContent = `${element("swung").textContent}: ${rows.join(", ")}`;
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
  tellAt = time + 3; // s, to those who hear the page
  pushes = [...pushes.filter((t) => t > time - SPAN), time];
  for (const loop of loops.filter(({ hasFallen }) => !hasFallen)) loop.largestError = 0;
  if (isStill && !running) pass(3);
}

function remember() {
  history.replaceState(null, "", addressOf(settings));
}

// Marks the preset that the settings are, and says what it shows. The controllers stay as they are with any preset.
function mark() {
  const now = presetNow();
  element("story").textContent = now?.story ?? "Your own settings.";
  for (const [i, link] of [...element("presets").children].entries()) {
    link.href = addressOf({ ...PRESETS[i].given, on: settings.on });
    link.ariaCurrent = PRESETS[i] === now ? "true" : null;
  }
}

// Starts the loops with the settings of the address.
function load() {
  const problems = readAddress(location.hash.slice(1), Object.keys(COLOURS));
  show();
  mark();
  begin();
  const more = problems.length > 3 ? [`and ${problems.length - 3} more`] : [];
  if (problems.length) say(["Not used of the address:", ...problems.slice(0, 3), ...more].join("\n"), true);
}

async function copyLink() {
  remember();
  try {
    await navigator.clipboard.writeText(location.href);
  } catch { // without a secure origin or the permission
    const field = document.createElement("textarea");
    field.value = location.href;
    document.body.append(field);
    field.select();
    const isCopied = document.execCommand("copy");
    field.remove();
    if (!isCopied) return say(`The browser does not let this page copy. The link is ${location.href}`, true);
  }
  element("copy").textContent = "Copied";
  say("The link has all settings.");
  setTimeout(() => { element("copy").textContent = "Copy link"; }, 2000);
}

// Changes a setting. What is fixed in the plant needs a new one, in the same state.
function change(name, value) {
  settings[name] = value;
  mark();
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
  COLOURS[name] ??= OWN[Object.keys(COLOURS).length % OWN.length];
  label.querySelector(".key").style.background = COLOURS[name];
  label.append(LABELS[name] ?? name);
  box.onchange = () => {
    const all = document.querySelectorAll("#controllers input:checked");
    settings.on = [...all].map((node) => node.id.slice(3)).join(",");
    mark();
    remember();
    begin();
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

function addSlider([name, label, , min, max, step]) {
  const node = document.createElement("label");
  node.className = "slider";
  node.innerHTML = '<span></span><span class="value"></span><input type="range">';
  const [text, , input] = node.children;
  text.textContent = label;
  Object.assign(input, { id: name, min, max, step });
  input.oninput = () => {
    change(name, +input.value);
    show();
  };
  input.onchange = remember; // and not while it moves: browsers limit how often
  element("sliders").append(node);
}

function addPreset({ name }) {
  const link = document.createElement("a");
  link.className = "button";
  link.textContent = name;
  link.onclick = () => {
    if (link.hash === location.hash) load(); // which is no change of the address
  };
  element("presets").append(link);
}

// Shows the settings in their controls.
function show() {
  for (const [name, , unit] of SETTINGS) {
    const input = element(name), text = `${settings[name]} ${unit}`;
    input.value = settings[name];
    input.previousSibling.textContent = text;
    input.setAttribute("aria-valuetext", text);
  }
  for (const name of ["speed", "dynamics"]) element(name).value = settings[name];
  const on = settings.on.split(",");
  for (const name of Object.keys(COLOURS)) element(`on-${name}`).checked = on.includes(name);
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
  element("copy").onclick = copyLink;
  for (const name of ["speed", "dynamics"]) {
    element(name).onchange = () => {
      change(name, element(name).value);
      remember();
    };
  }
  element("defaults").onclick = () => {
    for (const name of [...SETTINGS.map(([setting]) => setting), "dynamics"]) change(name, DEFAULTS[name]);
    show();
    remember();
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
  // A preset, another address, or one to which the browser goes back
  addEventListener("hashchange", load);
  element("file").onchange = () => element("file").files[0] && take(element("file").files[0]);
  const drag = (on) => document.body.classList.toggle("drag", on);
  addEventListener("dragover", (event) => {
    event.preventDefault();
    drag(true);
  });
  addEventListener("dragleave", (event) => event.relatedTarget ?? drag(false));
  addEventListener("drop", (event) => {
    event.preventDefault();
    drag(false);
    const [file] = event.dataTransfer.files;
    if (file) take(file);
  });
}

async function start() {
  const packed = JSON.parse(element("fmus").textContent);
  for (const [name, text] of Object.entries(packed)) {
    fmus[name] = await readFmu(unpacked(text));
  }
  for (const name of Object.keys(COLOURS)) addController(name);
  for (const [name, text] of Object.entries(packed)) addDownload(name, unpacked(text));
  SETTINGS.forEach(addSlider);
  PRESETS.forEach(addPreset);
  for (const plot of document.querySelectorAll(".plot")) {
    plot.setAttribute("role", "img");
    plot.setAttribute("aria-label", plot.previousSibling.textContent);
  }
  bind();
  go(!isStill);
  load();
  requestAnimationFrame(frame);
}

start().catch((error) => say(error.message, true));
