// The page holds states on a grid of the parameters; between them values are interpolated.
const source = {
  missing: "",
  unpacked: held.states.map(() => null),

  bytes(text) {
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  },

  async surface() {
    return [new Float32Array(this.bytes(held.rest)), new Uint32Array(this.bytes(held.triangles))];
  },

  // Whole numbers of a state: positions, then one byte a value
  whole(k) {
    if (!this.unpacked[k]) {
      const buffer = this.bytes(held.states[k].bytes), n = held.corners;
      this.unpacked[k] = [new Uint16Array(buffer, 0, 3 * n), new Uint8Array(buffer, 6 * n)];
    }
    return this.unpacked[k];
  },

  // Sampled states around values, with their shares
  around(values) {
    let found = [[1, 0]];
    about.parameters.forEach((p, k) => {
      const at = (values[k] - p.low) / (p.high - p.low) * (held.stops - 1);
      const first = Math.max(0, Math.min(held.stops - 2, Math.floor(at))), share = at - first;
      found = found.flatMap(([part, state]) => [[part * (1 - share), state * held.stops + first],
        [part * share, state * held.stops + first + 1]]);
    });
    found = found.filter(([part]) => part > 1e-9);
    // between states one of which was not found there is none
    return found.every(([, k]) => held.states[k].converged) ? found : null;
  },

  mixed(found, number) {
    return found.reduce((sum, [part, k]) => sum + part * number(held.states[k]), 0);
  },

  async state(values, field) {
    const found = this.around(values), n = held.corners;
    if (!found)
      return [{converged: false, verdict: "refused", indicator: null, probes: about.probes.map(() => null),
        reasons: ["the reduced model did not converge for these values"]}, null, null];
    const which = about.fields.findIndex((f) => f.name === field), [low, high] = about.fields[which].range;
    const states = found.map(([, k]) => held.states[k]), order = ["accepted", "doubtful", "refused"];
    const pair = (of) => [0, 1].map((end) => this.mixed(found, (state) => of(state)[end]));
    const facts = {
      converged: true, inside: true,
      probes: about.probes.map((_, k) => this.mixed(found, (state) => state.probes[k])),
      indicator: this.mixed(found, (state) => state.indicator),
      verdict: order[Math.max(...states.map((state) => order.indexOf(state.verdict)))],
      reasons: [...new Set(states.flatMap((state) => state.reasons))],
      J: pair((state) => state.J), range: pair((state) => state.ranges[which]),
    };
    const places = new Float32Array(3 * n), colours = new Float32Array(n);
    for (const [part, k] of found) {
      const [where, value] = this.whole(k);
      for (let i = 0; i < 3 * n; i++)
        places[i] += part * (held.ends[0][i % 3] + where[i] / 65534 * (held.ends[1][i % 3] - held.ends[0][i % 3]));
      for (let i = 0; i < n; i++) {
        const byte = value[which * n + i];
        colours[i] = byte === 255 ? 1e38 : colours[i] + part * (low + byte / 254 * (high - low));
      }
    }
    return [facts, places, colours];
  },

  // A probe along parameters: at the states on both sides
  async curves(values, probe, of) {
    return of.map((k) => {
      const p = about.parameters[k], x = [], y = [];
      for (let i = 0; i < held.stops; i++) {
        x.push(p.low + (p.high - p.low) * i / (held.stops - 1));
        const found = this.around(values.map((own, j) => j === k ? x[i] : own));
        y.push(found && this.mixed(found, (state) => state.probes[probe]));
      }
      return {parameter: k, x, y};
    });
  },
};
