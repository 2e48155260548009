// Rate curves: a chart to point at, its legend, and a small one for each asset.

const COLOURS = ["#3b7dd8", "#e07b39", "#2fa36b", "#c94f7c", "#8a63d2", "#b8912b", "#1fa2b5", "#d0503f", "#6f9321", "#7f8594",
  "#b355a8", "#5b6fbf"];
const MARKS = [
  (x, y, r) => `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`,
  (x, y, r) => `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}z`,
  (x, y, r) => `M${x} ${y - 1.2 * r}l${1.2 * r} ${2.2 * r}h${-2.4 * r}z`,
  (x, y, r) => `M${x} ${y - 1.4 * r}l${1.4 * r} ${1.4 * r}l${-1.4 * r} ${1.4 * r}l${-1.4 * r} ${-1.4 * r}z`,
];
const LARGE = { left: 62, right: 14, top: 10, bottom: 46, mark: 4.5, has_axes: true };
const SMALL = { width: 190, height: 110, left: 6, right: 6, top: 6, bottom: 6, mark: 1.6, has_axes: false };

function drawn(svg, name, attributes, text) {
  const made = document.createElementNS(svg.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  svg.append(made);
  return made;
}

// {colour, mark} of each group, by its place among all of them.
function styles(groups) {
  return new Map(groups.map((group, i) => [group, { colour: COLOURS[i % COLOURS.length], mark: MARKS[i % MARKS.length] }]));
}

// [{group, other, is_published, points: [{row, rate, quality}]}] of an asset, each by rate. withOthers: the published ones of
// other assets too; other: the name of such an asset.
function curvesOf(rows, asset, measure, withOthers) {
  const curves = new Map();
  for (const row of rows) {
    const quality = row.decibels[measure], isOther = row.asset !== asset;
    if (typeof quality !== "number" || (isOther && !(withOthers && row.published))) continue;
    const name = JSON.stringify([row.group, isOther ? row.asset : ""]);
    const made = { group: row.group, other: isOther ? row.asset : null, is_published: Boolean(row.published), points: [] };
    const curve = curves.get(name) ?? made;
    curve.points.push({ row, rate: row.rate, quality });
    curves.set(name, curve);
  }
  for (const curve of curves.values()) curve.points.sort((a, b) => a.rate - b.rate);
  return [...curves.values()];
}

// Draws curves into an <svg>, gives every point its place {x, y}, and returns the frame.
function drawCurves(svg, curves, size, look, axes) {
  svg.replaceChildren();
  svg.setAttribute("viewBox", `0 0 ${size.width} ${size.height}`);
  const points = curves.flatMap((curve) => curve.points);
  if (!points.length) {
    const place = { x: size.width / 2, y: size.height / 2, "text-anchor": "middle", class: "tick" };
    drawn(svg, "text", place, size.has_axes ? "nothing to show" : "–");
    return;
  }
  const [low, high] = range(points.map((point) => Math.log10(point.rate)), 0.04);
  const [least, most] = range(points.map((point) => point.quality), 0.06);
  const wide = size.width - size.left - size.right, tall = size.height - size.top - size.bottom;
  const x = (rate) => size.left + ((Math.log10(rate) - low) / (high - low)) * wide;
  const y = (quality) => size.top + ((most - quality) / (most - least)) * tall;
  if (size.has_axes) drawAxes(svg, size, { x, y, low: 10 ** low, high: 10 ** high, least, most }, axes);
  for (const curve of curves) {
    const { colour, mark } = look.get(curve.group);
    for (const point of curve.points) Object.assign(point, { x: x(point.rate), y: y(point.quality), curve });
    const line = curve.points.map((p, i) => `${i ? "L" : "M"}${p.x.toFixed(2)} ${p.y.toFixed(2)}`).join("");
    const drawing = drawn(svg, "g", { class: curve.is_published ? "curve published" : "curve", stroke: colour, fill: colour });
    curve.node = drawing;
    const marks = curve.points.map((p) => mark(p.x, p.y, size.mark)).join("");
    drawing.append(drawn(svg, "path", { class: "line", d: line }), drawn(svg, "path", { class: "marks", d: marks }));
  }
}

function drawAxes(svg, size, to, axes) {
  const right = size.width - size.right, bottom = size.height - size.bottom;
  for (const rate of logarithmicTicks(to.low, to.high, size.width / 70)) {
    drawn(svg, "path", { class: "grid", d: `M${to.x(rate)} ${size.top}V${bottom}` });
    drawn(svg, "text", { class: "tick", x: to.x(rate), y: bottom + 17, "text-anchor": "middle" }, short(rate));
  }
  for (const quality of ticks(to.least, to.most, 7)) {
    drawn(svg, "path", { class: "grid", d: `M${size.left} ${to.y(quality)}H${right}` });
    drawn(svg, "text", { class: "tick", x: size.left - 8, y: to.y(quality) + 4, "text-anchor": "end" }, String(quality));
  }
  drawn(svg, "text", { class: "axis", x: (size.left + right) / 2, y: size.height - 8, "text-anchor": "middle" }, axes.x);
  const middle = (size.top + bottom) / 2;
  drawn(svg, "text", { class: "axis", transform: `translate(15 ${middle}) rotate(-90)`, "text-anchor": "middle" }, axes.y);
}

// What is said of a point: [[name, value]].
function toldOf(row, measure, kind) {
  const value = row.values[measure], decibels = row.decibels[measure];
  const lines = [["setting", row.setting], ["group", row.group]];
  if (row.published) lines.push(["published", row.published], ["asset", row.asset]);
  lines.push([`${kind} bytes`, grouped(row.rate)]);
  if (kind === "texture" && !row.published) lines.push(["with geometry", grouped(row.bytes)]);
  lines.push([measure, `${written(decibels, 2)} dB` + (value === decibels ? "" : ` (${written(value, 4)})`)]);
  for (const side of ["encode", "decode"])
    if (row[`${side}_seconds`] !== null) lines.push([side, `${written(row[`${side}_seconds`], 2)} s`]);
  return lines;
}

// The section of curves. shared: {data, look, state, changed: () => void, picked: row => void}.
function curveSection(shared) {
  const { data, look, state } = shared;
  const svg = document.getElementById("chart"), tip = document.getElementById("tip");
  const hidden = new Set();
  let curves = [], current = null, size = null;

  function show(point, isByKey) {
    current = point;
    svg.querySelector(".halo")?.remove();
    for (const curve of curves) curve.node.classList.toggle("dim", point !== null && curve !== point.curve);
    tip.hidden = point === null;
    if (point === null) return;
    drawn(svg, "path", { class: "halo", d: MARKS[0](point.x, point.y, 9) });
    const lines = toldOf(point.row, state.measure, data.kind);
    tip.replaceChildren(...lines.flatMap(([name, value]) => [element("span", {}, name), element("b", {}, value)]));
    document.getElementById("readout").textContent = isByKey ? lines.map((line) => line.join(" ")).join(", ") : "";
    const box = svg.getBoundingClientRect(), x = box.left + point.x + 16, y = box.top + point.y + 16;
    tip.style.left = `${Math.max(4, x + tip.offsetWidth > innerWidth - 8 ? x - tip.offsetWidth - 32 : x)}px`;
    tip.style.top = `${Math.max(4, Math.min(y, innerHeight - tip.offsetHeight - 8))}px`;
  }

  function place(event) {
    const box = svg.getBoundingClientRect();
    return nearest(curves.flatMap((curve) => curve.points), event.clientX - box.left, event.clientY - box.top, 40);
  }

  svg.addEventListener("pointermove", (event) => show(place(event), false));
  svg.addEventListener("pointerleave", () => show(null, false));
  svg.addEventListener("blur", () => show(null, false));
  svg.addEventListener("click", () => current && shared.picked(current.row));
  svg.addEventListener("keydown", (event) => {
    if (event.key.startsWith("Arrow")) show(stepped(curves.map((c) => c.points), current, event.key), true);
    else if (event.key === "Escape") show(null, false);
    else if (event.key === "Enter" && current) shared.picked(current.row);
    else return;
    event.preventDefault();
  });

  function drawLegend(all) {
    const groups = [...new Set(all.map((curve) => curve.group))], buttons = groups.map((group) => {
      const button = element("button", { type: "button", "aria-pressed": String(!hidden.has(group)) });
      const icon = document.createElementNS(svg.namespaceURI, "svg");
      icon.setAttribute("viewBox", "0 0 20 12");
      drawn(icon, "path", { d: "M0 6H20", stroke: look.get(group).colour, "stroke-width": 2 });
      drawn(icon, "path", { d: look.get(group).mark(10, 6, 3.6), fill: look.get(group).colour });
      const others = new Set(all.filter((curve) => curve.group === group && curve.other).map((curve) => curve.other));
      button.append(icon, element("span", { textContent: [group, ...others].join(", ") }));
      button.addEventListener("click", () => {
        if (!hidden.delete(group)) hidden.add(group);
        draw();
        document.querySelectorAll("#legend button")[groups.indexOf(group)].focus();
      });
      const dim = (others) => curves.forEach((curve) => curve.node.classList.toggle("dim", others && curve.group !== group));
      button.addEventListener("pointerenter", () => dim(true));
      button.addEventListener("pointerleave", () => dim(false));
      return button;
    });
    document.getElementById("legend").replaceChildren(...buttons);
  }

  function draw() {
    show(null, false);
    const all = curvesOf(data.rows, state.asset, state.measure, document.getElementById("others").checked);
    curves = all.filter((curve) => !hidden.has(curve.group));
    document.getElementById("curves-title").textContent = `${state.measure} of ${state.asset}`;
    const width = Math.max(svg.parentNode.clientWidth, 240);
    size = { ...LARGE, width, height: Math.min(Math.max(width * 0.48, 240), 440) };
    drawCurves(svg, curves, size, look, { x: `${data.kind} bytes`, y: `${LOSS[state.measure] ?? state.measure}, dB` });
    drawLegend(all);
    const exact = data.rows.filter((row) => row.asset === state.asset && row.decibels[state.measure] === EXACT);
    document.getElementById("exact").textContent = exact.length
      ? "Exact, and so on no curve: " + exact.map((row) => `${row.setting} (${grouped(row.rate)} bytes)`).join(", ") : "";
    drawThumbnails();
  }

  function drawThumbnails() {
    const box = document.getElementById("thumbnails"), assets = [...new Set(data.rows.map((row) => row.asset))];
    box.hidden = assets.length < 2;
    box.replaceChildren(...assets.map((asset) => {
      const small = document.createElementNS(svg.namespaceURI, "svg");
      const shown = curvesOf(data.rows, asset, state.measure, false).filter((curve) => !hidden.has(curve.group));
      drawCurves(small, shown, SMALL, look, null);
      const name = element("span", { textContent: asset });
      const button = element("button", { type: "button", "aria-pressed": String(asset === state.asset) }, small, name);
      button.addEventListener("click", () => {
        state.asset = asset;
        shared.changed();
        box.querySelector("[aria-pressed=true]").focus();
      });
      return button;
    }));
  }

  for (const [name, groups] of [["show-all", []], ["show-none", look.keys()]]) {
    const all = [...groups];
    document.getElementById(name).addEventListener("click", () => {
      hidden.clear();
      all.forEach((group) => hidden.add(group));
      draw();
    });
  }
  new ResizeObserver(() => size && size.width !== Math.max(svg.parentNode.clientWidth, 240) && draw()).observe(svg.parentNode);
  document.getElementById("others").addEventListener("change", draw);
  document.getElementById("others-label").hidden = !data.rows.some((row) => row.published);
  return draw;
}
