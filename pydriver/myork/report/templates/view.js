// Sliders ask, the source answers, the body and the curves follow. One question at a time: the
// next one takes the latest values.
const $ = (id) => document.getElementById(id);
const WORDS = {accepted: ["good", "✓ accepted"], doubtful: ["unsure", "? doubtful"],
  refused: ["bad", "✗ refused"]};
const body = new Body($("body"));
const values = [...about.start];
// a curve along a parameter stays while only that one moves
const own = about.parameters.map(() => null);
let wanted = true, busy = false, last = null, due = 0;
// what a test reads: answers shown, and the values of the last of them
window.shown = {answers: 0, values: null, probes: null};

const text = (x, digits = 4) => x === null || x === undefined ? "–"
  : x !== 0 && Math.abs(x) < 1e-3 ? x.toExponential(digits - 1) : x.toPrecision(digits);
const short = (key) => {
  const word = key.split(".").pop();
  return about.parameters.filter((p) => p.key.split(".").pop() === word).length > 1 ? key : word;
};

function makeSliders() {
  about.parameters.forEach((p, k) => {
    const box = document.createElement("div"), label = document.createElement("label");
    const name = document.createElement("span"), output = document.createElement("output");
    const input = document.createElement("input"), bar = document.createElement("div");
    const trained = document.createElement("i");
    box.className = "slider";
    name.textContent = short(p.key);
    name.title = p.key;
    Object.assign(input, {type: "range", min: p.least, max: p.most, step: "any", id: `p${k}`});
    input.value = values[k];
    label.htmlFor = input.id;
    bar.className = "trained";
    const part = (x) => 100 * (x - p.least) / (p.most - p.least);
    trained.style.left = `${part(p.low)}%`;
    trained.style.right = `${100 - part(p.high)}%`;
    bar.append(trained);
    const write = () => {
      const slack = 1e-9 * (p.high - p.low);
      output.textContent = `${values[k].toPrecision(3)} ${p.unit}`;
      box.classList.toggle("outside", values[k] < p.low - slack || values[k] > p.high + slack);
    };
    input.addEventListener("input", () => {
      values[k] = Number(input.value);
      write();
      ask();
    });
    write();
    label.append(name, output);
    box.append(label, input, bar);
    $("sliders").append(box);
  });
  about.parameters.forEach((p) => {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `force against ${p.key}`);
    $("curves").append(svg);
  });
}

async function ask() {
  wanted = true;
  if (busy) return;
  busy = true;
  try {
    while (wanted) {
      wanted = false;
      const asked = [...values];
      const state = await source.state(asked, $("field").value);
      await new Promise(requestAnimationFrame);
      show(asked, ...state);
      // states come first: curves follow some times a second, and at the end
      if (!wanted || performance.now() > due) await askCurves(asked);
      draw();
    }
  } catch (reason) {
    fail(reason);
  }
  busy = false;
}

async function askCurves(asked) {
  const probe = $("probe").value, start = performance.now();
  const marks = asked.map((_, k) => [probe, ...asked.map((x, i) => i === k ? 0 : x)].join());
  const of = asked.map((_, k) => k).filter((k) => !own[k] || own[k].mark !== marks[k]);
  if (of.length)
    for (const one of await source.curves(asked, probe, of))
      own[one.parameter] = {...one, mark: marks[one.parameter]};
  // a fifth of the time at most
  const now = performance.now();
  due = now + Math.max(200, 4 * (now - start));
}

function show(asked, facts, places, colours) {
  const [mark, word] = WORDS[facts.verdict];
  $("verdict").className = `state ${mark}`;
  $("verdict").textContent = word;
  $("reasons").replaceChildren(...facts.reasons.map((reason) => {
    const line = document.createElement("li");
    line.textContent = reason;
    return line;
  }));
  $("indicator").textContent = facts.indicator === null ? "–" : `${text(100 * facts.indicator, 2)} %`;
  if ($("ms")) $("ms").textContent = `${facts.ms.toFixed(1)} ms`;
  // no number without a state
  facts.probes.forEach((value, k) => {
    $(`probe${k}`).textContent = facts.converged ? text(value) : "–";
    $(`bar${k}`).textContent = bar(facts, about.probes[k].of, value);
  });
  document.querySelector("section.body").classList.toggle("old", !facts.converged);
  last = {facts, asked};
  if (facts.converged) {
    $("j").textContent = `${text(facts.J[0], 3)} to ${text(facts.J[1], 3)}`;
    const field = about.fields.find((f) => f.name === $("field").value);
    const unit = field.unit === "-" ? "" : ` ${field.unit}`;
    $("low").textContent = text(field.range[0], 3);
    $("high").textContent = text(field.range[1], 3) + unit;
    $("here").textContent = `here ${text(facts.range[0], 3)} to ${text(facts.range[1], 3)}${unit}`;
    body.show(places, colours, field.range);
  }
  window.shown.answers += 1;
  Object.assign(window.shown, {values: asked, probes: facts.probes});
}

// Error of the force by the check on full solves and, in proportion, that of the full model;
// outside the trained range nothing was checked
function bar(facts, of, value) {
  if (!facts.converged || !facts.inside || !about.bar || of !== about.bar.of) return "";
  const size = Math.max(Math.abs(value), about.bar.least);
  const off = (about.bar.full + about.bar.reduced) * size + about.bar.between;
  return `± ${text(off, 2)}`;
}

function draw() {
  const probe = about.probes[$("probe").value], charts = $("curves").children;
  own.filter((one) => one).forEach((one) => {
    const p = about.parameters[one.parameter];
    const marker = last && last.facts.converged
      ? [last.asked[one.parameter], last.facts.probes[$("probe").value]] : null;
    const label = `${short(p.key)}${p.unit ? ` [${p.unit}]` : ""}`;
    chart(charts[one.parameter], label, `${probe.name}${probe.unit ? ` [${probe.unit}]` : ""}`, one, marker);
  });
}

function fail(reason) {
  $("verdict").className = "state bad";
  $("verdict").textContent = "✗ no answer";
  const line = document.createElement("li");
  line.textContent = `${reason.message || reason}${source.missing}`;
  $("reasons").replaceChildren(line);
}

async function begin() {
  makeSliders();
  $("colours").getContext("2d").drawImage(body.bar, 0, 0);
  for (const id of ["field", "probe"]) $(id).addEventListener("change", ask);
  try {
    body.surface(...await source.surface());
  } catch (reason) {
    fail(reason);
    return;
  }
  ask();
}

begin();
