// The page: what is shown, and its sections drawn again when that changes.

function choices(select, values, current) {
  select.replaceChildren(...values.map((value) => element("option", { value, textContent: value, selected: value === current })));
}

// The name of a group with its colour.
function named(group, look) {
  const dot = element("span", { class: "dot" });
  dot.style.background = look.get(group)?.colour ?? "transparent";
  return element("span", {}, dot, group);
}

function rowColumns(data, look) {
  const text = (head, key, cell) => ({ head, key, cell, is_text: true });
  const figure = (value, digits) => (digits === undefined ? grouped(value) : written(value, digits));
  const number = (head, key, digits) => ({ head, key, cell: (row) => figure(key(row), digits) });
  const badge = (row) => element("em", { class: "badge", title: row.published, textContent: row.badge });
  const setting = (row) => (row.published ? element("span", {}, row.setting, " ", badge(row)) : row.setting);
  const quality = ({ name, is_psnr }) => number(is_psnr ? `${name}, dB` : name, (row) => row.values[name], is_psnr ? 2 : 4);
  const sides = (key) => ["encode", "decode"].map(key);
  return [
    text("asset", (row) => row.asset), text("setting", (row) => row.setting, setting),
    text("group", (row) => row.group, (row) => named(row.group, look)),
    number("bytes", (row) => row.bytes), number("geometry", (row) => row.geometry),
    number("texture", (row) => row.bytes - row.geometry),
    ...data.measures.map(quality),
    ...sides((side) => number(`${side}, s`, (row) => row[`${side}_seconds`], 2)),
    ...sides((side) => number(`${side}, MB`, (row) => row[`${side}_memory`] && row[`${side}_memory`] / 1e6)),
  ];
}

// Columns of the table of BD-rates: mean, median, and each asset's [percent, overlap, reason].
function comparisonColumns(lines, look) {
  const assets = [...new Set(lines.flatMap((line) => Object.keys(line.assets)))];
  const column = (head, of, more) => ({
    head, key: (line) => of(line)[0], strength: (line) => Math.min(Math.abs(of(line)[0] ?? 0), 60) / 60,
    cell: (line) => signed(of(line)[0], 1), ...more,
    look: (line) => (of(line)[0] === null ? "none" : of(line)[0] < 0 ? "fewer" : "more") + more.look(line),
  });
  const sums = ["mean", "median"].map((name) => column(name, (line) => line[name], {
    look: () => " sum", title: (line) => `over ${line[name][1]} of ${assets.length} assets`,
    cell: (line) => element("b", {}, signed(line[name][0], 1), line[name][1] % assets.length ? ` (${line[name][1]})` : ""),
  }));
  const share = (overlap) => `${Math.round(100 * overlap)} % of both curves' range overlaps`;
  const percents = assets.map((asset) => {
    const of = (line) => line.assets[asset] ?? [null, null, "not measured on both sides"];
    return column(asset, of, {
      look: (line) => (of(line)[1] < 0.5 ? " faint" : ""),
      title: (line) => of(line)[2] ?? `${signed(of(line)[0], 2)} %; ${share(of(line)[1])}`,
    });
  });
  const group = { head: "group", key: (line) => line.group, is_text: true, cell: (line) => named(line.group, look) };
  return [group, ...sums, ...percents];
}

// Why cells of the table of BD-rates are empty.
function listReasons(box, lines) {
  const told = lines.flatMap((line) => Object.entries(line.assets).filter(([, cell]) => cell[2])
    .map(([asset, cell]) => `${line.group}, ${asset}: ${cell[2]}`));
  box.hidden = !told.length;
  box.querySelector("summary").textContent = `Why ${told.length === 1 ? "a cell is" : `${told.length} cells are`} empty`;
  box.querySelector("ul").replaceChildren(...told.map((textContent) => element("li", { textContent })));
}

function begin() {
  const data = JSON.parse(document.getElementById("data").textContent), get = (name) => document.getElementById(name);
  const assets = [...new Set(data.rows.map((row) => row.asset))];
  const ours = new Set(data.rows.filter((row) => !row.published).map((row) => row.asset));
  for (const row of data.rows) if (row.published) row.badge = ours.has(row.asset) ? "published" : "published, other material";
  const look = styles([...new Set(data.rows.map((row) => row.group))]);
  const preferred = data.measures.find((m) => m.name === "image PSNR Y") ?? data.measures[0];
  const state = { asset: assets[0], measure: preferred?.name ?? "" };
  const [byComparison, byRow, byMissing] = [0, 1, 2].map(() => ({ column: null, isDescending: false }));
  const shared = { data, look, state, changed: draw, picked: (row) => pictures.show(row) };
  const curves = curveSection(shared), pictures = pictureSection(shared);

  function drawComparison() {
    const found = data.comparisons[get("against").selectedIndex];
    if (!found) return;
    const lines = found.measures[state.measure] ?? [], loss = LOSS[state.measure];
    get("comparison-note").textContent = lines.length
      ? `Percent of ${data.kind} bytes at equal ${loss ?? state.measure}; negative needs fewer.`
      : `There is no ${state.measure} on both sides.`;
    listReasons(get("none"), lines);
    fillTable(get("comparison-table"), comparisonColumns(lines, look), lines, byComparison);
  }

  function drawRows() {
    const words = get("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = data.rows.filter((row) => (get("every").checked || row.asset === state.asset)
      && words.every((word) => `${row.asset} ${row.setting} ${row.group}`.toLowerCase().includes(word)));
    get("row-count").textContent = `${rows.length} of ${data.rows.length}`;
    fillTable(get("row-table"), rowColumns(data, look), rows, byRow);
  }

  function draw() {
    choices(get("asset"), assets, state.asset);
    choices(get("measure"), data.measures.map((m) => m.name), state.measure);
    drawComparison();
    curves();
    pictures.draw();
    drawRows();
  }

  for (const name of ["asset", "measure"]) {
    get(name).addEventListener("change", () => {
      state[name] = get(name).value;
      draw();
    });
  }
  get("filter").addEventListener("input", drawRows);
  get("every").addEventListener("change", drawRows);
  get("against").addEventListener("change", drawComparison);
  choices(get("against"), data.comparisons.map((c) => c.against), data.comparisons[0]?.against);
  get("comparison").hidden = !data.comparisons.length;
  get("missing").hidden = !data.missing.length;
  get("missing-count").textContent = String(data.missing.length);
  const reasons = Object.keys(data.missing[0] ?? {}).map((head) => ({ head, key: (row) => row[head], is_text: true }));
  fillTable(get("missing-table"), reasons, data.missing, byMissing);
  for (const link of document.querySelectorAll("nav a")) {
    const has = { "#comparison": data.comparisons.length, "#compared": data.images.length, "#missing": data.missing.length };
    link.hidden = has[link.hash] === 0;
  }
  const measured = data.rows.filter((row) => !row.published).length;
  const counts = { job: measured, asset: ours.size, group: look.size, "published point": data.rows.length - measured };
  const there = Object.entries(counts).filter(([, count]) => count);
  const told = there.map(([word, count]) => `${count} ${word}${count === 1 ? "" : "s"}`);
  if (data.missing.length) told.push(`${data.missing.length} missing`);
  const mixed = data.code.length > 1 ? " (not all by the same code)" : "";
  get("summary").textContent = `${told.join(", ")}; code ${data.code.join(", ")}${mixed}.`;
  draw();
}

if (typeof document !== "undefined") begin();
