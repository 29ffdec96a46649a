// Sliders choose among states that the page holds.
const $ = (id) => document.getElementById(id);
const WORDS = {accepted: ["good", "✓ accepted"], doubtful: ["unsure", "? doubtful"],
  refused: ["bad", "✗ refused"]};
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
const body = new Body($("body"));
const shades = ["#c6d4e1", "#a3bfd6", "#7fa9ca", "#5c93be", "#387db2"];

function touch() {
  const stops = about.axes.map((_, k) => Number($(`stop${k}`).value));
  const at = stops.reduce((sum, stop, k) => sum * about.stops[k].length + stop, 0);
  const state = about.states[at], facts = state.facts, n = about.corners;
  about.axes.forEach((axis, k) => {
    $(`chosen${k}`).textContent = `${state.values[k].toPrecision(3)} ${axis.unit}`;
  });
  const [mark, word] = WORDS[facts.verdict];
  $("verdict").className = `state ${mark}`;
  $("verdict").textContent = word;
  $("force").textContent = facts.converged ? facts.probes[0].toPrecision(4) : "–";
  $("error").textContent = facts.indicator === null ? "–" : `${(100 * facts.indicator).toPrecision(2)} %`;
  if (facts.converged) {
    const which = Number($("touched").value), field = about.fields[which];
    const buffer = bytes(state.places);
    $("low").textContent = field.range[0].toPrecision(3);
    $("high").textContent = `${field.range[1].toPrecision(3)} ${field.unit === "-" ? "" : field.unit}`;
    body.show(new Float32Array(buffer, 0, 3 * n), new Float32Array(buffer, 4 * n * (3 + which), n),
      field.range);
  }
  const own = about.axes.length > 1 ? stops[1] : 0, axis = about.axes[0];
  const lines = about.curves.map((y, k) => ({x: about.x, y, colour: shades[k], width: 1}));
  lines.push({x: about.x, y: about.curves[own], colour: "#0b5c96", width: 2.2});
  chart($("curve"), axis.unit ? `${axis.key} [${axis.unit}]` : axis.key,
    `${about.probes[0].name}${about.probes[0].unit ? ` [${about.probes[0].unit}]` : ""}`, lines,
    facts.converged ? [state.values[0], facts.probes[0]] : null);
}

body.surface(new Float32Array(bytes(about.rest)), new Uint32Array(bytes(about.triangles)));
$("colours").getContext("2d").drawImage(body.bar, 0, 0);
for (const control of [...about.axes.map((_, k) => $(`stop${k}`)), $("touched")])
  control.addEventListener("input", touch);
touch();
