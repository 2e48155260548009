// Figures: how they are ordered, written and placed. Nothing here knows the page.

export const EXACT = "exact";
export const LOSS = { SSIM: "−10 log10(1 − SSIM)", LPIPS: "−10 log10(LPIPS)" }; // what stands for decibels that are none

// A copy of rows ordered by key(row): numbers by size (EXACT above all), text as people order it, what is missing always last.
export function sorted(rows, key, isDescending) {
  const words = new Intl.Collator("en", { numeric: true });
  const known = (value) => value !== null && value !== undefined && value !== "";
  const size = (value) => (value === EXACT ? Infinity : value);
  const order = (a, b) => (typeof size(a) === "number" && typeof size(b) === "number" ? Math.sign(size(a) - size(b)) || 0
    : words.compare(String(a), String(b)));
  return rows.map((row) => [key(row), row]).sort(([a], [b]) => {
    if (!known(a) || !known(b)) return known(b) - known(a);
    return isDescending ? order(b, a) : order(a, b);
  }).map(([, row]) => row);
}

export function written(value, digits) {
  if (value === null || value === undefined) return "–";
  return typeof value === "number" ? value.toFixed(digits).replace(/^-/, "−") : String(value);
}

export function signed(value, digits) {
  return value === null || value === undefined ? "–" : (value > 0 ? "+" : "") + written(value, digits);
}

export function grouped(value) {
  return typeof value === "number" ? Math.round(value).toLocaleString("en-GB").replaceAll(",", " ") : "–";
}

// Bytes in few characters, for axes.
export function short(bytes) {
  const [unit, name] = bytes >= 1e6 ? [1e6, " MB"] : bytes >= 1e3 ? [1e3, " kB"] : [1, " B"];
  return Number((bytes / unit).toPrecision(3)) + name;
}

// [low, high] a little wider than the values.
export function range(values, share) {
  const low = Math.min(...values), high = Math.max(...values), margin = (high - low) * share || 0.5;
  return [low - margin, high + margin];
}

// Round numbers within low..high, about `count` of them.
export function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((times) => times * power >= rough);
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) found.push(Number((i * step).toPrecision(12)));
  return found;
}

// 1, 2 and 5 times powers of ten within low..high; of more than `count` the powers alone.
export function logarithmicTicks(low, high, count) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power++)
    for (const times of [1, 2, 5]) found.push(times * 10 ** power);
  const inside = found.filter((value) => value >= low && value <= high);
  if (inside.length < 3) return ticks(low, high, count);
  return inside.length <= count ? inside : inside.filter((value) => Number.isInteger(Math.log10(value)));
}

// The point [{x, y}] nearest to a place, or null where none is within reach.
export function nearest(points, x, y, reach) {
  let best = null, least = reach;
  for (const point of points) {
    const distance = Math.hypot(point.x - x, point.y - y);
    if (distance <= least) [best, least] = [point, distance];
  }
  return best;
}

// The point that an arrow key leads to. curves: [[{x, y}]], each by x; current: a point of them or null.
export function stepped(curves, current, key) {
  const at = curves.findIndex((curve) => curve.includes(current));
  if (at < 0) return curves[0]?.[0] ?? null;
  if (key === "ArrowLeft" || key === "ArrowRight") {
    const place = curves[at].indexOf(current) + (key === "ArrowRight" ? 1 : -1);
    return curves[at][place] ?? current;
  }
  const other = curves[(at + (key === "ArrowDown" ? 1 : curves.length - 1)) % curves.length];
  return nearest(other, current.x, current.y, Infinity);
}
