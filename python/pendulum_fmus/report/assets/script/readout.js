// The numbers of the sample at the cursor.
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
