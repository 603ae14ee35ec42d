// Values of the point of a figure that is pointed at, read off the figure itself; folded parts are opened for printing.
const told = document.createElement("div");
told.id = "told";
told.hidden = true;
told.setAttribute("aria-hidden", "true");
document.body.append(told);

function value(scale, place) {
  const [low, high, start, end] = scale.split(" ").map(Number);
  const part = (place - start) / (end - start);
  const found = scale.endsWith("log") ? low * (high / low) ** part : low + (high - low) * part;
  return found.toPrecision(4).replace(/\.?0+$/, "");
}

function nearest(figure, x, y) {
  let best = null;
  for (const path of figure.querySelectorAll(".valued")) {
    path.places ??= [...path.getAttribute("d").matchAll(/M([-\d.]+) ([-\d.]+)(?:l([-\d.]+) ([-\d.]+))?/g)].map((m) => m.slice(1).map(Number));
    for (const place of path.places) {
      const far = Math.hypot(place[0] - x, place[1] - y);
      if (far < (best?.far ?? 14)) best = { far, path, place };
    }
  }
  return best;
}

function say(figure, { path, place }) {
  const name = path.dataset.name ? `${path.dataset.name}: ` : "";
  if (path.dataset.unit) return `${(Math.hypot(place[2], place[3]) / path.dataset.enlarged).toPrecision(3)} ${path.dataset.unit}`;
  const labels = figure.dataset.labels.split("|");
  return `${name}${labels[0]} ${value(figure.dataset.x, place[0])}; ${labels[1]} ${value(figure.dataset.y, place[1])}`;
}

for (const figure of document.querySelectorAll("svg.figure:has(.valued)")) {
  const point = (event) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(figure.getScreenCTM().inverse());
    const found = nearest(figure, at.x, at.y);
    told.hidden = !found;
    if (!found) return;
    told.textContent = say(figure, found);
    told.style.left = `${Math.max(4, Math.min(event.clientX + 12, innerWidth - told.offsetWidth - 8))}px`;
    told.style.top = `${Math.max(4, event.clientY - told.offsetHeight - 12)}px`;
  };
  figure.addEventListener("pointermove", point);
  figure.addEventListener("pointerdown", point);
  figure.addEventListener("pointerleave", () => { told.hidden = true; });
}
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
