"use strict";
// Tables that a click on a heading sorts, and tables of data that are searched, filtered and drawn, too.
const make = (tag, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};
const saveCsv = (name, lines) => {
  const quoted = (value) => `"${String(value ?? "").replaceAll('"', '""')}"`;
  const text = lines.map((line) => `${line.map(quoted).join(",")}\n`).join("");
  make("a", { download: `${name}.csv`, href: URL.createObjectURL(new Blob([text], { type: "text/csv" })) }).click();
};
// A table that is cut is announced, and scrolls by keys.
function attendScroll(scroll) {
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", scroll.querySelector("caption")?.textContent || "Table");
  const measure = () => {
    const wide = scroll.scrollWidth > scroll.clientWidth + 1;
    scroll.classList.toggle("wide", wide);
    scroll.tabIndex = wide || scroll.scrollHeight > scroll.clientHeight + 1 ? 0 : -1;
  };
  new ResizeObserver(measure).observe(scroll);
  new ResizeObserver(measure).observe(scroll.firstElementChild);
}
for (const table of document.querySelectorAll("table")) {
  const body = table.tBodies[0], cells = (row) => [...row.cells].map((cell) => cell.textContent.trim());
  table.querySelectorAll("thead th").forEach((heading, column) => {
    const button = make("button", { type: "button" }, ...heading.childNodes);
    if (!button.textContent.trim()) return;
    heading.append(button);
    button.addEventListener("click", () => {
      const down = heading.getAttribute("aria-sort") === "ascending";
      table.querySelectorAll("th").forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      body.append(...[...body.rows].sort((a, b) => {
        const [x, y] = [cells(a)[column], cells(b)[column]], [p, q] = [Number(x), Number(y)];
        const order = Number.isNaN(p) || Number.isNaN(q) ? x.localeCompare(y) : p - q;
        return down ? -order : order;
      }));
    });
  });
  const save = make("button", { type: "button", textContent: "Save as CSV", onclick: () => saveCsv("table", [...table.rows].map(cells)) });
  const scroll = table.parentElement, box = make("div");
  scroll.replaceWith(box);
  box.append(scroll, make("div", { className: "tools" }, save));
  attendScroll(scroll);
}
const told = (value) => {
  if (value === null) return "n/a";
  if (typeof value !== "number" || Number.isInteger(value)) return String(value);
  return Math.abs(value) >= 1e7 || Math.abs(value) < 5e-4 ? value.toPrecision(3) : value.toFixed(3);
};
const MORE = 100, BINS = 24;
function explore(box, { columns, rows, links, by, looks }) {
  const shown = columns.map((each) => each.shown), only = new Map();
  let sorted = -1, down = false, words = "", most = MORE;
  const count = make("output"), head = make("tr"), body = make("tbody"), drawings = make("div", { className: "histograms" });
  const more = make("button", { type: "button", textContent: "Show more" });
  const [status, reason] = ["status", "message"].map((name) => columns.findIndex(({ key }) => key === name));
  const good = (value) => ["converged", "measured"].includes(value);
  const kept = () => rows.map((row, k) => k).filter((k) => {
    for (const [column, value] of only) if (String(rows[k][column]) !== value) return false;
    return !words || rows[k].some((value) => value !== null && String(value).toLowerCase().includes(words));
  });
  const inOrder = (which) => sorted < 0 ? which : which.sort((a, b) => {
    const [x, y] = [rows[a][sorted], rows[b][sorted]];
    if (x === null || y === null) return (x === null) - (y === null);
    const order = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
    return down ? -order : order;
  });
  const sort = (column) => { down = sorted === column && !down; sorted = column; draw(); };
  function cell(k, column) {
    const value = rows[k][column], { key, number } = columns[column], text = told(value);
    const made = make("td", { className: number ? "" : text.length > 60 ? "text long" : "text" });
    if (key === "status") made.className = `text ${good(value) ? "converged" : "other"}`;
    made.append(column === 0 && links?.[k] ? make("a", { href: links[k], textContent: text }) : text);
    return made;
  }
  function draw() {
    const which = inOrder(kept()), places = columns.map((each, k) => k).filter((k) => shown[k]);
    head.replaceChildren(...places.map((column) => {
      const heading = make("th", { scope: "col", className: columns[column].number ? "" : "text" });
      if (column === sorted) heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      heading.append(make("button", { type: "button", textContent: columns[column].title, onclick: () => sort(column) }));
      return heading;
    }));
    body.replaceChildren(...which.slice(0, most).flatMap((k) => {
      const row = make("tr", {}, ...places.map((column) => cell(k, column)));
      // The reason of a row without a good end is below it, unless its column is shown.
      if (!rows[k][reason] || shown[reason] || good(rows[k][status])) return [row];
      return [row, make("tr", { className: "reason" }, make("td", { colSpan: places.length, className: "text" }, make("div", { textContent: rows[k][reason] })))];
    }));
    count.textContent = `${Math.min(most, which.length)} of ${which.length} rows${which.length < rows.length ? `, ${rows.length} without filters` : ""}`;
    more.hidden = which.length <= most;
    drawings.replaceChildren(...places.filter((column) => columns[column].drawn).map((column) => histogram(which, column)).filter(Boolean));
  }
  function histogram(which, column) {
    const values = which.map((k) => [by < 0 ? "" : rows[k][by], rows[k][column]]).filter(([, value]) => value !== null);
    const all = values.map(([, value]) => value).sort((a, b) => a - b), at = (share) => all[Math.round(share * (all.length - 1))];
    if (all[0] === all.at(-1)) return null;
    // The outermost percent goes to the outermost bars, or one clash would hide all else.
    const cut = all.length > 50 ? 0.01 : 0, low = at(cut), high = at(1 - cut) > low ? at(1 - cut) : all.at(-1);
    const counts = new Map();
    for (const [name, value] of values) {
      if (!counts.has(name)) counts.set(name, new Array(BINS).fill(0));
      counts.get(name)[Math.min(BINS - 1, Math.max(0, Math.floor(BINS * (value - low) / (high - low))))] += 1;
    }
    const top = Math.max(...[...counts.values()].flat()), part = (value) => told(Number(value.toPrecision(3))).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
    const lines = [...counts].map(([name, own]) => {
      const points = own.flatMap((n, k) => [[10 * k, 60 - 56 * n / top], [10 * k + 10, 60 - 56 * n / top]]);
      return `<polyline fill="none" stroke-width="2" ${looks[name] ?? looks[""]} points="0,60 ${points.map((p) => p.join(",")).join(" ")} 240,60"/>`;
    });
    const title = columns[column].title, drawn = make("figure");
    const button = make("button", { type: "button", textContent: title, onclick: () => sort(column) });
    drawn.append(button);
    drawn.insertAdjacentHTML("beforeend", `<svg class="drawn" viewBox="-2 0 244 80" role="img"><line x1="0" x2="240" y1="60" y2="60" stroke="#888"/>${lines.join("")}<g font-size="13"><text x="0" y="76">${cut && low > all[0] ? "≤ " : ""}${part(low)}</text><text x="240" y="76" text-anchor="end">${cut && high < all.at(-1) ? "≥ " : ""}${part(high)}</text></g></svg>`);
    drawn.querySelector("svg").setAttribute("aria-label", `Histogram of ${title}, at most ${top} in a bar`);
    return drawn;
  }
  const controls = make("div", { className: "controls" });
  const search = make("input", { type: "search", placeholder: "find in rows", oninput: () => { words = search.value.toLowerCase(); most = MORE; draw(); } });
  search.setAttribute("aria-label", "Find in rows");
  controls.append(search);
  columns.forEach(({ number, title }, column) => {
    const values = number ? [] : [...new Set(rows.map((row) => row[column]).filter((value) => value !== null))];
    if (values.length < 2 || values.length > 12 || values.some((value) => value.length > 40) || (column === 0 && values.length === rows.length)) return;
    const choice = make("select", { onchange: () => {
      if (choice.value) only.set(column, choice.value.slice(1)); else only.delete(column);
      draw();
    } }, make("option", { value: "", textContent: "all" }), ...values.map((value) => make("option", { value: `=${value}`, textContent: value })));
    controls.append(make("label", {}, `${title} `, choice));
  });
  const chosen = make("div", {}, ...columns.map(({ title }, column) => make("label", {}, make("input", {
    type: "checkbox", checked: shown[column], disabled: column === 0, onchange: (event) => { shown[column] = event.target.checked; draw(); },
  }), ` ${title}`)));
  const save = make("button", { type: "button", textContent: "Save rows as CSV", onclick: () =>
    saveCsv("rows", [columns.map((each) => each.key), ...inOrder(kept()).map((k) => rows[k])]) });
  more.onclick = () => { most *= 4; draw(); };
  controls.append(save, count, make("details", {}, make("summary", { textContent: "Columns" }), chosen));
  const key = make("p");
  if (by >= 0) for (const name of new Set(rows.map((row) => row[by]))) {
    key.insertAdjacentHTML("beforeend", `<svg class="drawn" style="width: 2.5rem; vertical-align: middle" viewBox="0 0 40 10" aria-hidden="true"><line x1="0" x2="40" y1="5" y2="5" stroke-width="2.5" ${looks[name]}/></svg> `);
    key.append(`${name} \u2003`);
  }
  const table = make("table", {}, make("caption", { textContent: box.dataset.caption }), make("thead", {}, head), body);
  const scroll = make("div", { className: "scroll" }, table);
  box.append(key, drawings, controls, scroll, make("div", { className: "tools" }, more));
  attendScroll(scroll);
  draw();
  box.dataset.rows = String(rows.length);
}
for (const box of document.querySelectorAll(".explore")) explore(box, JSON.parse(box.querySelector("script").textContent));
// A box that scrolls is reached by the keyboard, too.
const reach = () => {
  for (const box of document.querySelectorAll(".scroll:not([role])")) {
    if (box.scrollWidth > box.clientWidth || box.scrollHeight > box.clientHeight) box.tabIndex = 0;
    else box.removeAttribute("tabindex");
  }
};
for (const event of ["load", "resize"]) addEventListener(event, reach);
reach();
