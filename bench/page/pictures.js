// Two pictures of one view, one over the other up to a divider.

// [{name, caption, pictures: {view: URI}}] of an asset: its source first, then its rows.
function sidesOf(data, asset) {
  const rows = data.rows.filter((row) => row.asset === asset), source = {}, sides = [];
  for (const row of rows) {
    const own = {};
    for (const [name, place] of Object.entries(row.pictures)) {
      const [kind, view] = name.split("_");
      if (kind === "picture") own[view] = data.images[place];
      else source[view] ??= data.images[place];
    }
    if (Object.keys(own).length) sides.push({ row, name: row.setting, pictures: own });
  }
  return Object.keys(source).length ? [{ row: null, name: "source", pictures: source }, ...sides] : sides;
}

// The section of pictures; shared as for curveSection. Returns {draw, show: row => void}.
function pictureSection(shared) {
  const { data, state } = shared, get = (name) => document.getElementById(name);
  const chosen = { left: 0, right: 1, view: null, zoom: 1 };
  let sides = [], drawnAsset = null;

  function buttons(box, values, current, label, choose) {
    box.replaceChildren(...values.map((value) => {
      const button = element("button", { type: "button", textContent: label(value), "aria-pressed": String(value === current) });
      button.addEventListener("click", () => {
        choose(value);
        draw();
        box.children[values.indexOf(value)].focus();
      });
      return button;
    }));
  }

  function caption(side) {
    if (!side.row) return "source";
    const quality = side.row.decibels[state.measure];
    const told = `${side.name}: ${grouped(side.row.rate)} ${data.kind} bytes`;
    if (quality === undefined) return told;
    return `${told}, ${state.measure} ${quality === EXACT ? EXACT : `${written(quality, 2)} dB`}`;
  }

  function draw() {
    if (drawnAsset !== state.asset) {
      sides = sidesOf(data, state.asset);
      Object.assign(chosen, { left: 0, right: Math.min(1, sides.length - 1) });
      drawnAsset = state.asset;
    }
    get("compared").hidden = !data.images.length;
    get("stage").hidden = !sides.length;
    if (!sides.length) {
      get("caption-left").textContent = "There are no pictures of this asset.";
      get("caption-right").textContent = "";
      return;
    }
    const views = Object.keys(sides[0].pictures);
    if (!views.includes(chosen.view)) chosen.view = views[0];
    buttons(get("views"), views, chosen.view, (view) => `view ${Number(view)}`, (view) => (chosen.view = view));
    buttons(get("zooms"), [1, 2, 4], chosen.zoom, (zoom) => `${zoom}×`, (zoom) => (chosen.zoom = zoom));
    for (const name of ["left", "right"]) {
      const side = sides[chosen[name]], image = get(`picture-${name}`);
      get(name).replaceChildren(...sides.map((s, i) => element("option", { value: i, selected: i === chosen[name],
        textContent: s.row ? `${s.row.group}: ${s.name}` : s.name })));
      image.src = side.pictures[chosen.view] ?? "";
      image.alt = caption(side);
      get(`caption-${name}`).textContent = caption(side);
    }
    get("pair").style.setProperty("--zoom", chosen.zoom);
    split();
  }

  function split() {
    get("pair").style.setProperty("--split", `${get("split").value / 10}%`);
  }

  for (const name of ["left", "right"]) {
    get(name).addEventListener("change", () => {
      chosen[name] = Number(get(name).value);
      draw();
    });
  }
  get("split").addEventListener("input", split);
  return {
    draw,
    show(row) {
      const place = sides.findIndex((side) => side.row === row);
      if (place < 0) return;
      chosen.right = place;
      draw();
      get("compared").scrollIntoView({ behavior: "smooth" });
    },
  };
}
