// A curve in SVG: x, y (null: a gap); a marker at the state.
function ticks(low, high, most) {
  const rough = (high - low) / most, ten = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * ten).find((s) => s >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found.map((x) => Math.abs(x) < 1e-9 * step ? 0 : x);
}

function chart(svg, label, side, curve, marker) {
  const wide = 330, high = 200, left = 48, right = 10, top = 18, bottom = 34;
  const xs = [...curve.x], ys = [...curve.y];
  if (marker) { xs.push(marker[0]); ys.push(marker[1]); }
  const real = ys.filter((y) => y !== null);
  if (!real.length) { svg.replaceChildren(); return; }
  const span = (values) => {
    let low = Math.min(...values), top = Math.max(...values);
    if (top - low < 1e-12 * Math.max(Math.abs(low), Math.abs(top), 1e-300)) { low -= 1; top += 1; }
    return [low, top];
  };
  const [x0, x1] = span(xs), [y0, y1] = span([...real, 0]);
  const px = (x) => left + (x - x0) / (x1 - x0) * (wide - left - right);
  const py = (y) => high - bottom - (y - y0) / (y1 - y0) * (high - top - bottom);
  const parts = [];
  const add = (name, attributes, text) => {
    const part = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) part.setAttribute(key, attributes[key]);
    if (text !== undefined) part.textContent = text;
    parts.push(part);
  };
  const short = (x) => String(parseFloat(x.toPrecision(6)));
  for (const x of ticks(x0, x1, 5)) {
    add("line", {x1: px(x), x2: px(x), y1: top, y2: high - bottom, stroke: "#dfe4ea"});
    add("text", {x: px(x), y: high - bottom + 14, "text-anchor": "middle"}, short(x));
  }
  for (const y of ticks(y0, y1, 4)) {
    add("line", {x1: left, x2: wide - right, y1: py(y), y2: py(y), stroke: "#dfe4ea"});
    add("text", {x: left - 5, y: py(y) + 4, "text-anchor": "end"}, short(y));
  }
  let path = "", pen = "M";
  curve.x.forEach((x, k) => {
    if (curve.y[k] === null) { pen = "M"; return; }
    path += `${pen}${px(x).toFixed(1)} ${py(curve.y[k]).toFixed(1)}`;
    pen = "L";
  });
  add("path", {d: path, fill: "none", stroke: "#0b5c96", "stroke-width": 2.2});
  if (marker && marker[1] !== null)
    add("circle", {cx: px(marker[0]), cy: py(marker[1]), r: 4.5, fill: "#d55e00", stroke: "#fff"});
  add("text", {x: 0.5 * (left + wide - right), y: high - 4, "text-anchor": "middle"}, label);
  add("text", {x: 4, y: 11}, side);
  svg.setAttribute("viewBox", `0 0 ${wide} ${high}`);
  svg.replaceChildren(...parts);
}
