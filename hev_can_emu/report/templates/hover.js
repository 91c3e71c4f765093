for (const svg of document.querySelectorAll("svg[data-t0]")) {
  const { t0, t1, x0, x1 } = svg.dataset;
  const make = (name) => document.createElementNS("http://www.w3.org/2000/svg", name);
  const line = make("line"), label = make("text");
  line.setAttribute("class", "cursor");
  label.setAttribute("class", "cursor-time");
  const height = svg.viewBox.baseVal.height;
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * svg.viewBox.baseVal.width;
    if (x < +x0 || x > +x1) { line.remove(); label.remove(); return; }
    const t = +t0 + ((x - x0) / (x1 - x0)) * (t1 - t0);
    line.setAttribute("x1", x); line.setAttribute("x2", x);
    line.setAttribute("y1", 0); line.setAttribute("y2", height - 20);
    label.setAttribute("x", x); label.setAttribute("y", height - 1);
    label.setAttribute("text-anchor", "middle");
    label.textContent = t.toFixed(3) + " s";
    svg.append(line, label);
  });
  svg.addEventListener("pointerleave", () => { line.remove(); label.remove(); });
}
