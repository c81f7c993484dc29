// Where an axis has ticks, and what they say.
const DECADES = 2.2; // above, a logarithmic axis shows powers of ten

const minus = (text) => text.replaceAll("-", "−");
const raised = (number) =>
  [...String(number)].map((digit) => (digit === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit])).join("");

// Whole multiples of 1, 2 or 5 times a power of ten: the finest of which at most `most` are shown, but
// at least two.
function linearTicks(low, high, most) {
  const first = (step) => Math.ceil(low / step - 1e-9);
  const last = (step) => Math.floor(high / step + 1e-9);
  let exponent = Math.floor(Math.log10((high - low) / Math.max(most, 2))) - 1;
  const ticks = (step, exponent) =>
    Array.from({ length: last(step) - first(step) + 1 }, (_, k) => tick((first(step) + k) * step, exponent));
  for (let finer = []; ; exponent++) {
    for (const factor of [1, 2, 5]) {
      const found = ticks(factor * 10 ** exponent, exponent);
      if (found.length <= Math.max(most, 2)) return found.length < 2 ? finer : found;
      finer = found;
    }
  }
}

// A tick with as many decimals as a step of this power of ten needs.
function tick(value, exponent) {
  const text = value.toFixed(Math.max(0, -exponent)), at = Number(text) || 0;
  return { at, text: at ? minus(text) : text.replace("-", "") };
}

// Powers of ten, at most `most` of them.
function powerTicks(low, high, most) {
  const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
  const step = Math.max(1, Math.ceil((last - first + 1) / Math.max(most, 1)));
  const ticks = [];
  for (let k = Math.ceil(first / step) * step; k <= last; k += step) {
    ticks.push({ at: 10 ** k, text: "10" + raised(k) });
  }
  return ticks;
}

// The given leading digits of each decade.
function digitTicks(low, high, digits) {
  const ticks = [];
  for (let k = Math.floor(Math.log10(low)); k <= Math.log10(high); k++) {
    for (const digit of digits) {
      const at = Number(`${digit}e${k}`);
      if (at >= low * (1 - 1e-9) && at <= high * (1 + 1e-9)) ticks.push({ at, text: String(at) });
    }
  }
  return ticks;
}

// The ticks of an axis of `length` pixels on which a label takes `room` pixels.
function ticksOf(low, high, log, length, room) {
  const most = Math.floor(length / room), decades = Math.log10(high / low);
  if (!log) return linearTicks(low, high, most);
  if (decades > DECADES) return powerTicks(low, high, most);
  const gap = (share) => (length * share) / decades;
  const digits = gap(0.3) > 0.6 * room ? [1, 2, 5] : gap(0.47) > 0.6 * room ? [1, 3] : [1];
  const ticks = digitTicks(low, high, digits);
  return ticks.length > 2 ? ticks : linearTicks(low, high, most);
}
