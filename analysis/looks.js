// What a program can tell of a page. Complaints, as texts.
(printed) => {
  const found = new Set();
  const wide = document.documentElement.scrollWidth - innerWidth;
  if (wide > 0) found.add(`scrolls to the side by ${wide} px`);
  const luminance = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const ground = (element) => {
    for (let box = element; box; box = box.parentElement) {
      const colour = rgba(getComputedStyle(box).backgroundColor);
      if (colour[3] > 127) return colour;
    }
    return rgba("Canvas");
  };
  // The part of a line of text that its scrolling ancestors show.
  const visible = (line, of) => {
    let { left, top, right, bottom } = line;
    for (let box = of; box && box !== document.documentElement; box = box.parentElement) {
      const style = getComputedStyle(box);
      if (style.overflowX === "visible" && style.overflowY === "visible") continue;
      const edge = box.getBoundingClientRect();
      [left, top, right, bottom] = [Math.max(left, edge.left), Math.max(top, edge.top), Math.min(right, edge.right), Math.min(bottom, edge.bottom)];
    }
    return { left, top, right, bottom };
  };
  const lines = [];
  const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = words.nextNode(); text; text = words.nextNode()) {
    const of = text.parentElement, style = getComputedStyle(of), said = text.textContent.trim().slice(0, 40);
    const silent = ["SCRIPT", "STYLE", "NOSCRIPT", "OPTION"].includes(of.tagName);
    if (!said || silent || of.closest("math, [aria-hidden=true]") || style.clipPath === "inset(50%)") continue;
    if (!of.checkVisibility({ contentVisibilityAuto: true, opacityProperty: true, visibilityProperty: true })) continue;
    const [a, b] = [luminance(rgba(of.closest("svg") ? style.fill : style.color)), luminance(ground(of))].sort((x, y) => y - x);
    const least = parseFloat(style.fontSize) >= 24 ? 3 : 4.5, ratio = (a + 0.05) / (b + 0.05);
    if (ratio < least && !of.closest("svg.drawn")) found.add(`contrast ${ratio.toFixed(1)} of "${said}"`);
    for (let box = of; box !== document.documentElement; box = box.parentElement) {
      const cut = getComputedStyle(box).overflowX === "hidden" && box.scrollWidth > box.clientWidth + 1;
      if (cut && !box.closest("#viewer, .viewer")) found.add(`cut: "${said}"`);
    }
    const range = document.createRange();
    range.selectNodeContents(text);
    for (const line of range.getClientRects()) {
      const seen = visible(line, of);
      if (seen.right - seen.left > 2 && seen.bottom - seen.top > 4) lines.push({ ...seen, of, said });
    }
  }
  // Lines of text that lie on one another, by their bounding boxes; sorted, so that few pairs are compared.
  lines.sort((a, b) => a.top - b.top);
  lines.forEach((a, k) => {
    for (let j = k + 1; j < lines.length && lines[j].top < a.bottom - 4; j++) {
      const b = lines[j], across = Math.min(a.right, b.right) - Math.max(a.left, b.left), down = Math.min(a.bottom, b.bottom) - b.top;
      if (across > 3 && down > 5 && a.of !== b.of) found.add(`"${a.said}" overlaps "${b.said}"`);
    }
  });
  // Panels show something: words, controls, or a picture of more than one colour.
  const plain = (picture) => {
    const small = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    try {
      small.drawImage(picture, 0, 0, 64, 64);
      const pixels = small.getImageData(0, 0, 64, 64).data;
      return pixels.every((value, k) => Math.abs(value - pixels[k % 4]) < 8);
    } catch { return false; }
  };
  for (const picture of document.querySelectorAll("img, canvas")) {
    if (!picture.checkVisibility() || picture.getBoundingClientRect().width < 40) continue;
    if (picture.tagName === "IMG" && picture.complete && !picture.naturalWidth) found.add(`no picture: ${picture.alt}`);
    else if (plain(picture)) found.add(`empty picture: ${picture.alt || picture.parentElement.getAttribute("aria-label") || picture.id}`);
    const scroll = picture.closest(".scroll");
    if (scroll && innerWidth > 700 && scroll.scrollWidth > scroll.clientWidth + 1) found.add(`cut picture: ${picture.alt}`);
  }
  for (const panel of document.querySelectorAll("main section, figure, fieldset, .scroll, .plots > *, .hero > *, .viewer")) {
    const { width, height } = panel.getBoundingClientRect();
    if (width * height < 3000 || !panel.checkVisibility()) continue;
    if (!panel.innerText.trim() && !panel.querySelector("img, canvas, svg, input, select, button")) found.add(`empty panel ${panel.className || panel.tagName}`);
  }
  for (const picture of document.querySelectorAll("img")) if (!picture.alt) found.add("image without words");
  for (const control of document.querySelectorAll("input, select, button")) {
    const labels = [...(control.labels || [])].map((label) => label.textContent).join("");
    const name = control.getAttribute("aria-label") || control.getAttribute("title") || control.textContent || labels;
    if (!name.trim() && control.type !== "hidden") found.add(`nameless ${control.tagName}`);
  }
  const ids = [...document.querySelectorAll("[id]")].filter((box) => !box.closest("svg")).map((box) => box.id);
  for (const id of ids.filter((name, k) => ids.indexOf(name) !== k)) found.add(`two of id ${id}`);
  if (!document.documentElement.lang) found.add("no language");
  if (!document.title.trim()) found.add("no title");
  if (document.querySelectorAll("h1").length !== 1) found.add("not one h1");
  if (document.querySelectorAll("main, [role=main]").length !== 1) found.add("not one main");
  for (const table of document.querySelectorAll("table")) {
    if (!table.checkVisibility() || table.role === "presentation") continue;
    if (!table.querySelector("th") && !table.matches(".indextable, .domainindex-table")) // Indexes of Sphinx.
      found.add("table without headings");
    const over = table.getBoundingClientRect().width > innerWidth, scroll = table.closest(".scroll, .table-wrapper, .cell_output");
    if (over && !scroll) found.add("table over the edge");
    if (printed && scroll && scroll.scrollWidth > scroll.clientWidth + 1) found.add(`printed table loses columns: ${table.innerText.slice(0, 40)}`);
  }
  return [...found];
}
