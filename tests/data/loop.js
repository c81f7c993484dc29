// Couples FMUs in sequential order by web/fmu.js, and returns the bytes of what is recorded, in base64.

// `loop` has the components in order, each with its FMU and its start values, the connections, and what to record.
function couple(loop, fmus) {
  const parts = Object.fromEntries(loop.components.map(({ name, fmu, starts }) => {
    const setUp = (it) => {
      for (const [variable, type, value] of starts) {
        if (type === "float64") it.set(variable, value);
        else it.setWhole(variable, type, value);
      }
    };
    return [name, new Instance(fmus[fmu], setUp, loop.step)];
  }));
  const split = (name) => [parts[name.slice(0, name.indexOf("."))], name.slice(name.indexOf(".") + 1)];
  const newest = Object.fromEntries(loop.outputs.map((name) => [name, 0]));
  const read = (prefix) => {
    for (const name of loop.outputs) {
      if (name.startsWith(`${prefix}.`)) newest[name] = parts[prefix].get(split(name)[1]);
    }
  };
  loop.components.forEach(({ name }) => read(name));
  const rows = Object.fromEntries(loop.outputs.map((name) => [name, new Float64Array(loop.steps + 1)]));
  const keep = (k) => loop.outputs.forEach((name) => { rows[name][k] = newest[name]; });
  for (let k = 0; k < loop.steps; k++) {
    keep(k);
    for (const { name } of loop.components) {
      for (const [from, to] of loop.connections) {
        if (to.startsWith(`${name}.`)) parts[name].set(split(to)[1], newest[from]);
      }
      parts[name].step(loop.step + k * loop.step, loop.step);
      read(name);
    }
  }
  keep(loop.steps);
  const text = (bytes) => {
    let all = "";
    for (let at = 0; at < bytes.length; at += 1024) all += String.fromCharCode(...bytes.subarray(at, at + 1024));
    return btoa(all);
  };
  return Object.fromEntries(loop.outputs.map((name) => [name, text(new Uint8Array(rows[name].buffer))]));
}
