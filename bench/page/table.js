// Tables that can be sorted by each of their columns.

const AT_ONCE = 250; // rows; thousands of them take a browser seconds

// A new element; properties are set as they are, so text stays text; "class", "data-..." and "aria-..." are attributes.
function element(name, properties = {}, ...inside) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "class" || key === "role" || key.includes("-")) made.setAttribute(key, value);
    else made[key] = value;
  }
  made.append(...inside);
  return made;
}

// Fills a <table>. columns: [{head, key: row => value to sort by, cell: row => text or node (the key's value if there is none),
// look: row => class, is_text, title: row => text}]; at: {column, isDescending, rows}, kept in it as the reader changes it.
function fillTable(table, columns, rows, at) {
  const heads = columns.map((column, number) => {
    const words = column.head.split("_").flatMap((word, i) => (i ? [element("wbr"), `_${word}`] : [word]));
    const button = element("button", { type: "button" }, ...words);
    button.addEventListener("click", () => {
      at.isDescending = at.column === number ? !at.isDescending : false;
      Object.assign(at, { column: number, rows: AT_ONCE });
      fillTable(table, columns, rows, at);
      table.querySelectorAll("th button")[number].focus();
    });
    const direction = at.column === number ? (at.isDescending ? "descending" : "ascending") : "none";
    return element("th", { scope: "col", "aria-sort": direction, class: column.is_text ? "text" : "" }, button);
  });
  const ordered = at.column === null ? rows : sorted(rows, columns[at.column].key, at.isDescending), shown = at.rows ?? AT_ONCE;
  const body = ordered.slice(0, shown).map((row) => element("tr", {}, ...columns.map((column) => tableCell(column, row))));
  if (ordered.length > shown) {
    const more = element("button", { type: "button", textContent: `${ordered.length - shown} more` });
    more.addEventListener("click", () => {
      at.rows = shown + 4 * AT_ONCE;
      fillTable(table, columns, rows, at);
    });
    body.push(element("tr", {}, element("td", { class: "text", colSpan: columns.length }, more)));
  }
  table.replaceChildren(element("thead", {}, element("tr", {}, ...heads)), element("tbody", {}, ...body));
}

function tableCell(column, row) {
  const look = [column.is_text ? "text" : "", column.look?.(row) ?? ""].join(" ").trim();
  const shown = column.cell ? column.cell(row) : column.key(row) ?? "–";
  const cell = element("td", {}, shown);
  if (look) cell.className = look;
  if (column.title) cell.title = column.title(row);
  const strength = column.strength?.(row);
  if (strength !== undefined) cell.style.setProperty("--strength", strength);
  return cell;
}
