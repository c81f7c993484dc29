"use strict";
// The settings of the loops: their ranges, the presets, and how an address states them.

// Name, label, unit, minimum, maximum, step, start, and the variable, if it is one of an FMU.
const SETTINGS = [
  ["r", "Set-point", "°", -60, 60, 0.1, 0],
  ["d", "Disturbance of the measurement", "°", -5, 5, 0.1, 0],
  ["push", "Strength of a push of 0.3 s", "N", 1, 150, 1, 80],
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
const DEFAULTS = { ...Object.fromEntries(SETTINGS.map(([name, , , , , , start]) => [name, start])), dynamics: "3", on: "Pid,PidRbf", speed: "1" };
const settings = { ...DEFAULTS };

const PAPER = { r: 57.3, dynamics: "2", push: 60 };
const PRESETS = [
  { name: "A push", given: {},
    story: "With a PID controller alone (blue), the pendulum swings more than three times as far as with the same PID and a neural network that learns as it runs (orange)." },
  { name: "The paper's step", given: PAPER,
    story: "At a set-point of 1 rad, on the linear plant, the network has learnt the force that the tilt needs. After the push, its error is less than a tenth of the PID's." },
  { name: "8 ms late: the network loses", given: { ...PAPER, delay: 8 },
    story: "The paper's step, but the measurement arrives 8 ms late. PID trembles. The network learns from late errors, shakes, and lets the push swing the pendulum more than twice as far as PID does." },
  { name: "No integral", given: { r: 20, ki: 0, push: 60 },
    story: "Without its integral term, PID stays more than 1° away from the set-point of 20°. The network takes over the term's work, and reaches it." },
  { name: "Weak gains", given: { kp: 100, kd: 10 },
    story: "With a third of the proportional gain and a tenth of the derivative gain, PID falls over. The network adds the force that is missing." },
  { name: "Learning too fast", given: { ...PAPER, eta: 1 },
    story: "The loop bears a learning rate of 0.58 at most. At 1, the network never comes to rest: see how its force jumps between the limits, 100 N. PID, which does not learn, is calm." },
  { name: "At the limit", given: { push: 104 },
    story: "The push is stronger than the largest force, 100 N. No controller can do more than push back with all of it, so all swing alike." },
];

// The preset that has the present settings.
function presetNow() {
  const compared = [...SETTINGS.map(([name]) => name), "dynamics"];
  return PRESETS.find(({ given }) => compared.every((name) => settings[name] === (given[name] ?? DEFAULTS[name])));
}

const addressOf = (given) => `#${new URLSearchParams(given)}`;

// Takes the settings from an address, and the defaults for the others; returns what is wrong with it.
function readAddress(address, controllers) {
  Object.assign(settings, DEFAULTS);
  const problems = [];
  for (const [name, value] of new URLSearchParams(address)) {
    const refuse = (text, expected, used = "") => problems.push(`${name}=${text.slice(0, 40)}: expected ${expected}${used}`);
    const instead = `; ${DEFAULTS[name]} is used instead`;
    const [, , , min, max] = SETTINGS.find(([setting]) => setting === name) ?? [];
    if (name === "on") {
      const unknown = new Set(value.split(",").filter(Boolean));
      const known = controllers.filter((controller) => unknown.delete(controller));
      settings.on = known.length || !unknown.size ? known.join(",") : DEFAULTS.on;
      const expected = `${controllers.join(", ")}, or an FMU that was dropped on this page`;
      if (unknown.size) refuse([...unknown].join(","), expected, known.length ? "" : instead);
    } else if (min !== undefined) {
      const isWhole = name === "delay"; // in samples
      const fits = value.trim() && +value >= min && +value <= max && (!isWhole || Number.isInteger(+value));
      if (fits) settings[name] = +value;
      else refuse(value, `a ${isWhole ? "whole " : ""}number from ${min} to ${max}`, instead);
    } else if (Object.hasOwn(DEFAULTS, name)) {
      const choices = [...element(name).options];
      if (choices.some((choice) => choice.value === value)) settings[name] = value;
      else refuse(value, choices.map((choice) => `${choice.value} (${choice.text})`).join(" or "), instead);
    } else {
      refuse(value, `one of the settings ${Object.keys(DEFAULTS).join(", ")}`);
    }
  }
  return problems;
}
