// The page: what is shown, and its sections drawn again when that changes.

function choices(select, values, current) {
  select.replaceChildren(...values.map((value) => element("option", { value, textContent: value, selected: value === current })));
}

function rowColumns(data, look) {
  const number = (head, key, digits) => ({ head, key, cell: (row) => (digits === undefined ? grouped(key(row)) : written(key(row), digits)) });
  const name = (row) => {
    const dot = element("span", { class: "dot" });
    dot.style.background = look.get(row.group).colour;
    return element("span", {}, dot, row.group);
  };
  return [
    { head: "asset", key: (row) => row.asset, is_text: true },
    { head: "setting", key: (row) => row.setting, is_text: true, title: (row) => row.published ?? "",
      cell: (row) => (row.published ? element("span", {}, row.setting, " ", element("em", { class: "badge", textContent: row.badge })) : row.setting) },
    { head: "group", key: (row) => row.group, is_text: true, cell: name },
    number("bytes", (row) => row.bytes), number("geometry", (row) => row.geometry), number("texture", (row) => row.bytes - row.geometry),
    ...data.measures.map((measure) => number(measure.is_psnr ? `${measure.name}, dB` : measure.name,
      (row) => row.values[measure.name], measure.is_psnr ? 2 : 4)),
    number("encode, s", (row) => row.encode_seconds, 2), number("decode, s", (row) => row.decode_seconds, 2),
    number("encode, MB", (row) => row.encode_memory && row.encode_memory / 1e6), number("decode, MB", (row) => row.decode_memory && row.decode_memory / 1e6),
  ];
}

// Columns of the table of BD-rates: its assets, mean and median.
function comparisonColumns(lines, look) {
  const assets = [...new Set(lines.flatMap((line) => Object.keys(line.assets)))];
  const coloured = (percent, share) => (percent === null || percent === undefined ? "none" : `${percent < 0 ? "fewer" : "more"}${share < 0.5 ? " faint" : ""}`);
  const strength = (percent) => Math.min(Math.abs(percent ?? 0), 60) / 60;
  const percents = assets.map((asset) => {
    const of = (line) => line.assets[asset] ?? [null, null, "not measured on both sides"];
    return {
      head: asset, key: (line) => of(line)[0], cell: (line) => signed(of(line)[0], 1), look: (line) => coloured(...of(line)),
      strength: (line) => strength(of(line)[0]),
      title: (line) => of(line)[2] ?? `${signed(of(line)[0], 2)} %; ${Math.round(100 * of(line)[1])} % of both curves overlaps`,
    };
  });
  const summaries = ["mean", "median"].map((name) => ({
    head: name, key: (line) => line[name][0], look: (line) => `sum ${coloured(line[name][0], 1)}`, strength: (line) => strength(line[name][0]),
    cell: (line) => element("b", { textContent: signed(line[name][0], 1) + (line[name][1] < assets.length ? ` (${line[name][1]})` : "") }),
    title: (line) => `over ${line[name][1]} of ${assets.length} assets`,
  }));
  const group = { head: "group", key: (line) => line.group, is_text: true, cell: (line) => {
    const dot = element("span", { class: "dot" });
    dot.style.background = look.get(line.group)?.colour ?? "transparent";
    return element("span", {}, dot, line.group);
  } };
  return [group, ...summaries, ...percents];
}

function begin() {
  const data = JSON.parse(document.getElementById("data").textContent), get = (name) => document.getElementById(name);
  const assets = [...new Set(data.rows.map((row) => row.asset))];
  const ours = new Set(data.rows.filter((row) => !row.published).map((row) => row.asset));
  for (const row of data.rows) if (row.published) row.badge = ours.has(row.asset) ? "published" : "published, other material";
  const look = styles([...new Set(data.rows.map((row) => row.group))]);
  const preferred = data.measures.find((m) => m.name === "image PSNR Y") ?? data.measures[0];
  const state = { asset: assets[0], measure: preferred?.name ?? "" };
  const sorts = { comparison: { column: null, isDescending: false }, rows: { column: null, isDescending: false }, missing: { column: null, isDescending: false } };
  const shared = { data, look, state, changed: draw, picked: (row) => pictures.show(row) };
  const curves = curveSection(shared), pictures = pictureSection(shared);

  function drawComparison() {
    const found = data.comparisons[get("against").selectedIndex];
    if (!found) return;
    const lines = found.measures[state.measure] ?? [];
    get("comparison-note").textContent = lines.length
      ? `Percent of ${data.kind} bytes at equal ${state.measure}; negative needs fewer. What is in a cell's mean, and why one is empty, is told by pointing at it.`
      + (data.measures.find((m) => m.name === state.measure).is_psnr ? "" : ` ${state.measure} is compared in decibels, −10 log10(${state.measure === "SSIM" ? "1 − SSIM" : "LPIPS"}).`)
      : `There is no ${state.measure} on both sides.`;
    fillTable(get("comparison-table"), comparisonColumns(lines, look), lines, sorts.comparison);
  }

  function drawRows() {
    const words = get("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = data.rows.filter((row) => (get("every").checked || row.asset === state.asset)
      && words.every((word) => `${row.asset} ${row.setting} ${row.group}`.toLowerCase().includes(word)));
    get("row-count").textContent = `${rows.length} of ${data.rows.length}`;
    fillTable(get("row-table"), rowColumns(data, look), rows, sorts.rows);
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
  const told = ["asset", "setting", "group", "method", "reason"].map((name) => ({ head: name, key: (row) => row[name], is_text: true }));
  fillTable(get("missing-table"), told, data.missing, sorts.missing);
  for (const link of document.querySelectorAll("nav a")) {
    const has = { "#comparison": data.comparisons.length, "#compared": data.images.length, "#missing": data.missing.length };
    link.hidden = has[link.hash] === 0;
  }
  const measured = data.rows.filter((row) => !row.published).length, megabytes = (document.documentElement.innerHTML.length / 1e6).toFixed(1);
  get("summary").textContent = `${measured} jobs, ${ours.size} assets, ${look.size} groups`
    + (measured < data.rows.length ? `, ${data.rows.length - measured} published points` : "")
    + (data.missing.length ? `, ${data.missing.length} missing` : "") + `; code ${data.code.join(", ")}`
    + (data.code.length > 1 ? " (not all by the same code)" : "") + `; this page has ${megabytes} MB and loads nothing.`;
  draw();
}

if (typeof document !== "undefined") begin();
