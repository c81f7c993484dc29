"use strict";
// The loops on the page: their settings, the picture of the carts, and the plots.

const STEP = 0.001;
const SPAN = 8; // seconds in a plot
const PUSH = 0.1; // duration of a push in seconds
const COLOURS = { Pid: "#2a78d6", PidRbf: "#e0622b", IpidRbf: "#1f9e6e" };
const LABELS = { Pid: "PID", PidRbf: "PID-RBF", IpidRbf: "IPID-RBF" };
const OWN = "#9a5fd1";
const element = (id) => document.getElementById(id);

// Name, label, unit, minimum, maximum, step, start, and the variable, if it is one of an FMU.
const SETTINGS = [
  ["r", "Set-point", "°", -20, 20, 0.5, 0],
  ["d", "Disturbance of the measurement", "°", -5, 5, 0.1, 0],
  ["push", "Strength of a push", "N", 1, 60, 1, 20],
  ["delay", "Delay of the measurement", "ms", 0, 30, 1, 0],
  ["kp", "Proportional gain", "", 0, 1000, 10, 300, "pid.kp"],
  ["ki", "Integral gain", "", 0, 2000, 10, 500, "pid.ki"],
  ["kd", "Derivative gain", "", 0, 300, 1, 100, "pid.kd"],
  ["eta", "Learning rate of the network", "", 0, 2, 0.05, 0.3, "rbf.eta"],
  ["umax", "Limit of the force", "N", 1, 200, 1, 100, "u_max"],
  ["M", "Mass of the cart", "kg", 0.2, 5, 0.001, 1.096, "M"],
  ["m", "Mass of the pendulum", "kg", 0.02, 1, 0.001, 0.109, "m"],
  ["l", "Half the length of the pendulum", "m", 0.1, 1, 0.01, 0.25, "l"],
];
const settings = Object.fromEntries(SETTINGS.map(([name, , , , , , start]) => [name, start]));
Object.assign(settings, { dynamics: "3", on: "Pid,IpidRbf", speed: "1" });

const fmus = {};
let loops = [];
let time = 0, running = true, push = 0, pushUntil = 0;

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
    this.colour = COLOURS[name] ?? OWN;
    this.plant = newPlant();
    this.controller = new Instance(fmus[name], tune);
    this.measured = [];
    // The time of the plant starts again when the plant is replaced.
    this.time = this.plantTime = 0;
    this.state = { theta: 0, omega: 0, x: 0, v: 0 };
    this.history = [];
  }

  step(r, d, force) {
    const { controller, plant } = this;
    this.measured.push(plant.get("theta"));
    while (this.measured.length > settings.delay + 1) this.measured.shift();
    controller.set("r", r);
    if (controller.fmu.variables.d) controller.set("d", d);
    controller.set("y", this.measured[0]);
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
    const degrees = 180 / Math.PI;
    const { theta } = this.state;
    this.history.push({
      t: time, angle: [theta * degrees], error: [(r - theta) * degrees], force: [this.u ?? 0],
      weights: of("rbf.w"), activations: of("rbf.h"),
    });
    while (this.history[0].t < time - SPAN) this.history.shift();
  }
}

function restart() {
  time = pushUntil = 0;
  try {
    loops = settings.on.split(",").filter((name) => fmus[name]).map((name) => new Loop(name));
  } catch (error) {
    loops = [];
    say(error.message, true);
  }
}

// Advances all loops; one that fails is taken out, and its error shown.
function advance(steps) {
  const [r, d] = [settings.r, settings.d].map((degrees) => (degrees * Math.PI) / 180);
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
  for (const loop of loops) loop.read(r);
}

// Says how far the pendulums have swung since the last push.
function compare() {
  const swung = loops.map(({ name, history }) => {
    const angles = history.filter(({ t }) => t >= pushUntil - PUSH).map(({ angle }) => Math.abs(angle[0]));
    return `${LABELS[name] ?? name} ${Math.max(0, ...angles).toFixed(2)}°`;
  });
  element("effect").textContent = `Largest angle since the last push: ${swung.join(", ")}`;
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
  const metre = Math.min((0.62 * height) / (2 * settings.l), width / 2.5);
  const ground = height - 46;
  // The picture follows the first cart.
  const centre = loops[0]?.state.x ?? 0;
  c.strokeStyle = c.fillStyle = colour("--soft");
  c.lineWidth = 1;
  c.beginPath();
  c.moveTo(0, ground + 30);
  c.lineTo(width, ground + 30);
  const tick = metre > 240 ? 0.25 : metre > 120 ? 0.5 : 1;
  for (let x = Math.ceil((centre - width / 2 / metre) / tick) * tick; x < centre + width / 2 / metre; x += tick) {
    const at = width / 2 + (x - centre) * metre;
    c.moveTo(at, ground + 30);
    c.lineTo(at, ground + 35);
    c.fillText(`${x.toFixed(2)} m`, at + 3, ground + 44);
  }
  c.stroke();
  for (const loop of [...loops].reverse()) {
    const at = width / 2 + (loop.state.x - centre) * metre;
    const [top, side] = [2 * settings.l * Math.cos(loop.state.theta), 2 * settings.l * Math.sin(loop.state.theta)];
    c.globalAlpha = loop === loops[0] ? 1 : 0.75;
    c.fillStyle = c.strokeStyle = loop.colour;
    c.fillRect(at - 34, ground, 68, 22);
    for (const wheel of [-20, 20]) {
      c.beginPath();
      c.arc(at + wheel, ground + 24, 6, 0, 7);
      c.fill();
    }
    c.lineWidth = 7;
    c.lineCap = "round";
    c.beginPath();
    c.moveTo(at, ground);
    c.lineTo(at + side * metre, ground - top * metre);
    c.stroke();
  }
  c.globalAlpha = 1;
  if (time < pushUntil) {
    c.fillStyle = colour("--text");
    c.fillText(push > 0 ? "push ▶" : "◀ push", width / 2 + (push > 0 ? -90 : 50), ground + 14);
  }
}

function drawPlot(id) {
  const { c, width, height } = canvas(id);
  const all = loops.flatMap((loop) => loop.history.flatMap((row) => row[id]));
  let [low, high] = [Math.min(0, ...all), Math.max(0, ...all)];
  if (high - low < 1e-9) [low, high] = [-1, 1];
  const y = (value) => height - 6 - ((value - low) / (high - low)) * (height - 12);
  const x = (t) => 48 + ((t - time + SPAN) / SPAN) * (width - 52);
  c.fillStyle = colour("--soft");
  c.strokeStyle = colour("--line");
  for (const value of [low, 0, high]) {
    c.beginPath();
    c.moveTo(48, y(value));
    c.lineTo(width, y(value));
    c.stroke();
    c.fillText(String(+value.toPrecision(3)), 0, Math.min(height - 2, Math.max(11, y(value) + 4)));
  }
  for (const loop of loops) {
    c.strokeStyle = loop.colour;
    c.lineWidth = 1.5;
    for (let i = 0; i < (loop.history.at(-1)?.[id].length ?? 0); i++) {
      c.beginPath();
      for (const row of loop.history) c.lineTo(x(row.t), y(row[id][i] ?? 0));
      c.stroke();
    }
  }
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
  label.innerHTML = '<input type="checkbox"> <span class="key"></span>';
  label.style.display = "block";
  const box = label.querySelector("input");
  box.id = `on-${name}`;
  box.checked = settings.on.split(",").includes(name);
  label.querySelector(".key").style.background = COLOURS[name] ?? OWN;
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
    const name = fmu.name in COLOURS ? `${fmu.name} (yours)` : fmu.name;
    fmus[name] = fmu;
    const box = element(`on-${name}`) ?? addController(name);
    box.checked = true;
    box.onchange();
    if (loops.some((loop) => loop.name === name)) say(`${name} balances the pendulum.`);
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
  node.innerHTML = "<span></span><output></output><input type=range>";
  node.querySelector("span").textContent = label;
  const [input, output] = [node.querySelector("input"), node.querySelector("output")];
  Object.assign(input, { id: name, min, max, step, value: settings[name] });
  const show = () => { output.textContent = `${+input.value} ${unit}`; };
  input.oninput = () => {
    show();
    change(name, +input.value);
  };
  show();
  element("sliders").append(node);
}

function bind() {
  element("run").onclick = () => {
    running = !running;
    element("run").textContent = running ? "Pause" : "Run";
    element("run").setAttribute("aria-pressed", running);
  };
  element("once").onclick = () => advance(1);
  element("reset").onclick = restart;
  element("left").onclick = () => shove(-settings.push);
  element("right").onclick = () => shove(settings.push);
  for (const name of ["speed", "dynamics"]) {
    element(name).value = settings[name];
    element(name).onchange = () => change(name, element(name).value);
  }
  element("scene").onpointerdown = (event) => {
    const middle = event.target.getBoundingClientRect();
    shove(event.clientX < middle.left + middle.width / 2 ? settings.push : -settings.push);
  };
  element("scene").onkeydown = ({ key }) => {
    if (key === "ArrowLeft") shove(-settings.push);
    if (key === "ArrowRight") shove(settings.push);
  };
  element("file").onchange = () => element("file").files[0] && take(element("file").files[0]);
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file) take(file);
  });
}

async function start() {
  for (const [name, value] of new URLSearchParams(location.hash.slice(1))) {
    const known = SETTINGS.find(([setting]) => setting === name);
    if (known && value.trim() && +value >= known[3] && +value <= known[4]) settings[name] = +value;
    if (name === "on" || (name === "dynamics" && /^[23]$/.test(value))) settings[name] = value;
  }
  const packed = JSON.parse(element("fmus").textContent);
  for (const [name, text] of Object.entries(packed)) {
    fmus[name] = await readFmu(unpacked(text));
  }
  for (const name of Object.keys(COLOURS)) addController(name);
  for (const [name, text] of Object.entries(packed)) addDownload(name, unpacked(text));
  SETTINGS.forEach(addSlider);
  bind();
  restart();
  shove(settings.push);
  requestAnimationFrame(frame);
}

start().catch((error) => say(error.message, true));
