"use strict";
// What all viewers of pages share: a ground that follows the scheme, buttons, names of residues, and jumps.
const placeOf = (atom) => `${(atom.chain ?? "").trim()}:${atom.resi}${(atom.icode ?? "").trim()}`;
const residueOf = (atom) => placeOf(atom).replace(":", `:${atom.resn}${/\d$/.test(atom.resn) ? " " : ""}`);
const namedAtom = (atom) => `${residueOf(atom)}, atom ${atom.atom}`;
const stages = [];
function makeViewer(id) {
  const box = document.getElementById(id), stage = document.createElement("div"), tools = document.createElement("div");
  const ground = () => getComputedStyle(document.documentElement).getPropertyValue("--card").trim();
  stage.className = "stage";
  tools.className = "tools";
  box.replaceWith(stage);
  stage.append(box, tools);
  const viewer = $3Dmol.createViewer(id, { id: `${id}-canvas`, backgroundColor: ground(), preserveDrawingBuffer: true });
  for (const media of ["(prefers-color-scheme: dark)", "print"])
    matchMedia(media).addEventListener("change", () => { viewer.setBackgroundColor(ground()); viewer.render(); });
  const add = (words, act) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: words });
    button.addEventListener("click", () => act(button));
    tools.append(button);
  };
  let home = {}, spins = false;
  add("Reset", () => { viewer.removeAllLabels(); viewer.zoomTo(home); viewer.render(); });
  add("Spin", (button) => { spins = !spins; viewer.spin(spins ? "y" : false); button.setAttribute("aria-pressed", spins); });
  add("Full screen", () => (document.fullscreenElement ? document.exitFullscreen() : stage.requestFullscreen()));
  add("Save picture", () => {
    const link = document.createElement("a");
    link.download = `${document.title}.png`;
    link.href = viewer.pngURI();
    link.click();
  });
  stage.addEventListener("fullscreenchange", () => { viewer.resize(); viewer.render(); });
  const readout = document.createElement("output");
  readout.textContent = "Point at a residue for its name, click to go there.";
  tools.append(readout);
  const label = (atom, words) => viewer.addLabel(words, { position: atom, fontSize: 13, backgroundOpacity: 0.75 });
  // To the C-alpha of a residue, or its first atom; false where no model has it.
  const jump = (place) => {
    const found = viewer.selectedAtoms({ predicate: (atom) => placeOf(atom) === place });
    if (!found.length) return false;
    const atom = found.find((each) => each.atom === "CA") ?? found[0];
    viewer.removeAllLabels();
    label(atom, residueOf(atom));
    const at = { predicate: (each) => placeOf(each) === place };
    const touches = (a) => found.some((b) => (a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2 < 16);
    const near = new Set(viewer.selectedAtoms({}).filter(touches).map(placeOf));
    const around = { predicate: (each) => near.has(placeOf(each)) };
    viewer.addStyle(around, { stick: { radius: 0.06 } });
    viewer.addStyle(at, { stick: { radius: 0.15 } });
    viewer.zoomTo(around);
    viewer.render();
    readout.textContent = residueOf(atom);
    box.dataset.at = place;
    return true;
  };
  // Before a style is given, which decides what can be pointed at.
  const attend = () => {
    viewer.setHoverDuration(60);
    viewer.setHoverable({}, true, (atom) => { readout.textContent = namedAtom(atom); }, () => {});
    viewer.setClickable({}, true, (atom) => jump(placeOf(atom)));
  };
  const look = (at = {}) => { home = at; viewer.zoomTo(at); viewer.render(); };
  stages.push({ stage, jump });
  return { viewer, box, attend, look, label, jump };
}
document.addEventListener("click", (event) => {
  const place = event.target.closest?.("[data-residue]")?.dataset.residue;
  const found = place && stages.find((each) => each.jump(place));
  if (found) found.stage.scrollIntoView({ block: "nearest" });
});
