// A server answers; the page's address holds the token.
const source = {
  missing: ": does myork view still run?",

  async fetched(question) {
    const answer = await fetch(location.pathname.replace(/\/?$/, "/") + question, {cache: "no-store"});
    if (!answer.ok) throw new Error(await answer.text());
    return answer;
  },

  // JSON with its length before it, then numbers
  async numbers(question) {
    const buffer = await (await this.fetched(question)).arrayBuffer();
    const size = new DataView(buffer).getUint32(0, true);
    const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
    return [facts, buffer, 4 + size];
  },

  async surface() {
    const [{corners, triangles}, buffer, start] = await this.numbers("surface");
    this.corners = corners;
    return [new Float32Array(buffer, start, 3 * corners),
      new Uint32Array(buffer, start + 12 * corners, 3 * triangles)];
  },

  async state(values, field) {
    const n = this.corners;
    const [facts, buffer, start] = await this.numbers(`state?p=${values.join(",")}&field=${field}`);
    return [facts, new Float32Array(buffer, start, 3 * n),
      new Float32Array(buffer, start + 12 * n, n)];
  },

  async curves(values, probe, of) {
    const found = await this.fetched(`curves?p=${values.join(",")}&probe=${probe}&of=${of.join(",")}`);
    return found.json();
  },
};
