"use strict";
// FMUs in the browser: reads an archive, and calls the core module of its component by the canonical ABI.

const CS = "fmi:fmi3/co-simulation@3.0.0";
const STATUS = ["ok", "warning", "discard", "error", "fatal"];

const unpacked = (text) => Uint8Array.from(atob(text), (char) => char.charCodeAt(0));

// The files of a zip archive, each as a function that returns its content.
function filesOf(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let end = bytes.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw new Error("it is not a zip archive, as an FMU is");
  const files = new Map();
  for (let n = view.getUint16(end + 10, true), at = view.getUint32(end + 16, true); n > 0; n--) {
    const [method, size] = [view.getUint16(at + 10, true), view.getUint32(at + 20, true)];
    const [name, extra, comment] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    const local = view.getUint32(at + 42, true);
    const path = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + name));
    files.set(path, async () => {
      const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
      const packed = bytes.subarray(start, start + size);
      if (method === 0) return packed;
      const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
      return new Uint8Array(await new Response(stream).arrayBuffer());
    });
    at += 46 + name + extra + comment;
  }
  return files;
}

// The core modules of a component, and of the components in it.
function* coreModules(component) {
  let at = 8;
  while (at < component.length) {
    const id = component[at++];
    let size = 0, byte, shift = 0;
    do {
      byte = component[at++];
      size += (byte & 127) * 2 ** shift;
      shift += 7;
    } while (byte & 128);
    const content = component.subarray(at, (at += size));
    if (id === 1) yield content;
    if (id === 4) yield* coreModules(content);
  }
}

// The module of a component that has all functions of the FMU, and a memory.
async function moduleOf(component) {
  for (const core of coreModules(component)) {
    const module = await WebAssembly.compile(core);
    const names = WebAssembly.Module.exports(module).map(({ name }) => name);
    if (names.includes("memory") && names.some((name) => /do[-_]step$/.test(name))) return module;
  }
  throw new Error("no module of its component has all of the code, as this page needs; cargo fmu simulate runs such components");
}

// What the page needs of modelDescription.xml.
function describe(text) {
  const xml = new DOMParser().parseFromString(text, "text/xml").documentElement;
  const variables = {};
  for (const variable of xml.querySelectorAll("ModelVariables > *")) {
    variables[variable.getAttribute("name")] = {
      reference: +variable.getAttribute("valueReference"),
      causality: variable.getAttribute("causality"),
    };
  }
  const id = xml.querySelector("CoSimulation")?.getAttribute("modelIdentifier");
  return { name: xml.getAttribute("modelName"), token: xml.getAttribute("instantiationToken"), id, variables };
}

// An FMU: its description, and its compiled module.
async function readFmu(bytes, read = describe) {
  const files = filesOf(bytes);
  const content = files.get("modelDescription.xml");
  if (!content) throw new Error("it has no modelDescription.xml");
  const fmu = read(new TextDecoder().decode(await content()));
  const binary = files.get(`binaries/wasm32-wasip2/${fmu.id}.wasm`);
  if (!binary) throw new Error("it has no WebAssembly component for co-simulation; export it with --fmi 3.0 --target wasm");
  return { ...fmu, module: await moduleOf(await binary()) };
}

// What a component that was compiled for WASI finds there: no files and no arguments, clocks that stand still, random
// numbers that are 0, and the console for lines that it prints. A result is 0, which is an empty text or list, none, or
// success. One of more than a number is written to a place, which is the last argument.
function wasi(memory) {
  const bytes = (at, n) => new Uint8Array(memory().buffer, at, n);
  const zeros = (n) => (...given) => void bytes(given.at(-1), n).fill(0);
  const zero = () => 0, long = () => 0n;
  const time = (at) => (at === undefined ? 0n : zeros(12)(at));
  let printed = "";
  const print = (stream, from, n, at) => {
    const lines = (printed + new TextDecoder().decode(bytes(from, n))).split("\n");
    printed = lines.pop();
    lines.forEach((line) => console.log(line));
    zeros(1)(at);
  };
  const room = (stream, at) => {
    zeros(1)(at);
    new DataView(memory().buffer).setBigUint64(at + 8, 4096n, true);
  };
  return {
    "get-arguments": zeros(8), "get-environment": zeros(8), "get-directories": zeros(8), "initial-cwd": zeros(1),
    "get-terminal-stdin": zeros(1), "get-terminal-stdout": zeros(1), "get-terminal-stderr": zeros(1),
    "get-stdin": zero, "get-stdout": zero, "get-stderr": zero, now: time, resolution: time,
    "insecure-seed": zeros(16), "get-random-u64": long, "get-insecure-random-u64": long,
    "[method]output-stream.check-write": room, "[method]output-stream.write": print,
    "[method]output-stream.blocking-write-and-flush": print, "[method]output-stream.flush": zeros(1),
    "[method]output-stream.blocking-flush": zeros(1), "[method]output-stream.subscribe": zero,
    "[method]pollable.block": zero,
  };
}

// An instance for co-simulation, with the functions of FMI 3.0.
class Instance {
  constructor(fmu, setUp = () => {}, start = 0) {
    this.fmu = fmu;
    this.messages = [];
    const text = (at, n) => new TextDecoder().decode(new Uint8Array(this.core.memory.buffer, at, n));
    const provided = {
      "log-message": (a, an, status, c, cn, message, n) => this.messages.push([STATUS[status], text(message, n)]),
      "intermediate-update": () => { throw new Error("no early return was allowed"); },
    };
    const granted = wasi(() => this.core.memory);
    const imports = {};
    for (const { module, name } of WebAssembly.Module.imports(fmu.module)) {
      const fail = () => { throw new Error(`the component needs ${module} ${name}, which this page does not have`); };
      let found = provided[name];
      if (name.startsWith("[resource-")) found = (handle) => handle; // which is what it stands for
      if (module.startsWith("wasi")) found ??= granted[name] ?? fail; // when it is called
      (imports[module] ??= {})[name] = found ?? fail();
    }
    this.core = new WebAssembly.Instance(fmu.module, imports).exports;
    this.memory = new DataView(this.core.memory.buffer);
    this.core._initialize?.();
    [this.getFloat64, this.setFloat64, this.doStep] = ["get-float64", "set-float64", "do-step"].map((name) => this.named(name));
    this.freeValues = this.core[`cabi_post_${CS}#[method]co-simulation-instance.get-float64`] ?? (() => {});
    const create = "instantiate-co-simulation";
    const instantiate = this.named(create, "static");
    const texts = ["it", fmu.token].concat(instantiate.length > 10 ? [""] : []); // the path of resources, in one draft
    const made = instantiate(...texts.flatMap((text) => this.text(text)), 0, 0, 0, 0, 0, 0);
    if (!this.view.getUint8(made)) throw new Error(this.failure(create));
    this.pointer = this.view.getUint32(made + 4, true);
    setUp(this);
    this.check(this.named("enter-initialization-mode")(this.pointer, 0, 0, start, 0, 0), "enter-initialization-mode");
    this.check(this.named("exit-initialization-mode")(this.pointer), "exit-initialization-mode");
  }

  // A function of the module: under its name in the interface, or under its own, if the component has another one
  // for hosts.
  named(name, kind = "method") {
    return this.core[`${CS}#[${kind}]co-simulation-instance.${name}`] ?? this.core[name.replaceAll("-", "_")];
  }

  // The memory of the module, which is another buffer when it has grown.
  get view() {
    const { buffer } = this.core.memory;
    if (this.memory.buffer !== buffer) this.memory = new DataView(buffer);
    return this.memory;
  }

  text(value) {
    const bytes = new TextEncoder().encode(value);
    const at = this.core.cabi_realloc(0, 0, 1, bytes.length);
    new Uint8Array(this.core.memory.buffer, at, bytes.length).set(bytes);
    return [at, bytes.length];
  }

  failure(name) {
    return `${this.fmu.name}: ${this.messages.at(-1)?.[1] ?? `${name} failed`}`;
  }

  check(status, name) {
    if (status > 1) throw new Error(this.failure(name));
  }

  // A list with the value reference of a variable.
  references(name) {
    const variable = this.fmu.variables[name];
    if (!variable) throw new Error(`${this.fmu.name} has no variable ${name}`);
    const at = this.core.cabi_realloc(0, 0, 4, 4);
    this.view.setUint32(at, variable.reference, true);
    return at;
  }

  // What a function reads of the elements of a variable, from their place and their number.
  read(name, of) {
    const answer = this.getFloat64(this.pointer, this.references(name), 1), view = this.view;
    if (view.getUint8(answer)) throw new Error(this.failure("get-float64"));
    const read = of(view, view.getUint32(answer + 4, true), view.getUint32(answer + 8, true));
    this.freeValues(answer);
    return read;
  }

  get(name) {
    return this.read(name, (view, at) => view.getFloat64(at, true));
  }

  getAll(name) {
    return this.read(name, (view, at, n) => Array.from({ length: n }, (_, i) => view.getFloat64(at + 8 * i, true)));
  }

  set(name, value) {
    const references = this.references(name), at = this.core.cabi_realloc(0, 0, 8, 8);
    this.view.setFloat64(at, value, true);
    this.check(this.setFloat64(this.pointer, references, 1, at, 1), "set-float64");
  }

  // Sets a Boolean or an enumeration.
  setWhole(name, type, value) {
    const references = this.references(name), at = this.core.cabi_realloc(0, 0, 8, 8);
    this.view.setBigInt64(at, BigInt(value), true);
    this.check(this.named(`set-${type}`)(this.pointer, references, 1, at, 1), `set-${type}`);
  }

  step(time, size) {
    const answer = this.doStep(this.pointer, time, size, 1);
    if (this.view.getUint8(answer)) throw new Error(this.failure("do-step"));
  }
}
