// One episode on the page: its frames, loaded in the background, and what happened in each step.

import { actionInWords, ask, element, make, offered, Refused } from "./common.js";
import { drawChart, moveChart } from "./chart.js";
import { showGrid } from "./grid.js";

const CHUNK = 16; // frames in one request, the most that the server sends
const RETRY = 500; // ms after a request that was one too many

export class Pane {
  constructor(source, number, details, name) {
    this.source = source;
    this.number = number;
    this.details = details;
    this.step = 0;
    this.frames = [];
    this.probabilities = null;
    this.view = null;
    this.shown = Promise.resolve();
    this.root = element("pane").content.cloneNode(true).firstElementChild;
    this.part = (selector) => this.root.querySelector(selector);
    this.introduce(name);
  }

  static async open(source, number, name) {
    const answer = await ask("episode", { source, episode: number });
    return new Pane(source, number, await answer.json(), name);
  }

  get steps() {
    return this.details.steps;
  }

  introduce(name) {
    const { env_id, seed, demonstrator, policy } = this.details;
    const title = env_id.replace(/^magical\/|-v0$/g, "").replace("-", " ");
    this.root.setAttribute("aria-label", `${name}: ${title}`);
    this.part("h2").textContent = title;
    this.part(".close").setAttribute("aria-label", `Close ${title}`);
    const parts = [demonstrator, seed === null ? null : `seed ${seed}`, this.finalScore()];
    if (policy && policy !== demonstrator) parts.push(`policy ${policy}`);
    if (!this.details.has_poses) {
      parts.push("recorded frames only: no poses, so step-by-step scores are unknown");
    }
    if (this.details.is_recovered) parts.push("poses recovered from frames");
    this.part(".legend").hidden = !this.details.actors;
    this.part(".about").textContent = parts.filter(Boolean).join(" · ");
  }

  finalScore() {
    const { score, published_code_score: published } = this.details;
    return score === null ? `score ${published.toFixed(2)} by the published code`
      : `score ${score.toFixed(2)}`;
  }

  close() {
    this.closed = true;
    this.root.remove();
  }

  // Frames

  async load(view) {
    if (view === this.view) return;
    this.view = view;
    this.frames = [];
    const from = this.details.views.includes(view) ? view : this.details.views[0];
    while (!this.closed && this.view === view) {
      const first = this.missing();
      if (first === null) return;
      const fields = { source: this.source, episode: this.number, view: from, first, count: CHUNK };
      try {
        const answer = await ask("frames", fields);
        const found = split(await answer.arrayBuffer());
        if (this.view === view) found.forEach((blob, i) => { this.frames[first + i] = blob; });
      } catch (error) {
        if (!(error instanceof Refused && [429, 503].includes(error.status))) throw error;
        await new Promise((done) => setTimeout(done, RETRY));
      }
      if (this.step >= first && this.step < first + CHUNK) this.show(this.step);
    }
  }

  // The next frame to load: the first missing one after the present step, else before it.
  missing() {
    const order = [this.step, 0];
    for (const start of order) {
      for (let step = start; step <= this.steps; step += 1) {
        if (!this.frames[step]) return step;
      }
    }
    return null;
  }

  has(step) {
    return Boolean(this.frames[Math.min(step, this.steps)]);
  }

  // A step

  show(step) {
    this.step = Math.min(step, this.steps);
    this.shown = this.shown.catch(() => {}).then(() => this.paint(this.step));
    moveChart(this.part(".chart"), this.step, this.length);
    this.showFacts();
    const executed = this.details.actions[this.step] ?? null;
    const row = this.probabilities?.[this.step] ?? null;
    const last = this.probabilities?.at(-1) ?? null;
    showGrid(this.part(".grid"), row ?? last, executed);
    this.part(".grid").toggleAttribute("data-over", !row);
  }

  async paint(step) {
    const blob = this.frames[step];
    if (!blob || step !== this.step || blob === this.painted) return;
    const image = await createImageBitmap(blob);
    const canvas = this.part(".picture");
    if (canvas.width !== image.width) canvas.width = image.width;
    if (canvas.height !== image.height) canvas.height = image.height;
    canvas.getContext("2d").drawImage(image, 0, 0);
    this.painted = blob;
  }

  facts() {
    const { scores, actions, actors, expert_actions: labels, policy_actions: chosen } = this.details;
    const at = (table) => actionInWords(table[this.step]);
    const facts = [["Action", at(actions)]];
    if (scores) facts.unshift(["Score", scores[this.step].toFixed(2)]);
    if (labels) facts.push(["To imitate", at(labels)]);
    if (chosen) facts.push(["Policy’s choice", at(chosen)]);
    if (actors) facts.push(["Acts", offered.actors[actors[this.step]] ?? "–"]);
    return facts;
  }

  showFacts() {
    const facts = this.facts();
    this.part(".facts").replaceChildren(
      ...facts.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))),
    );
    const words = facts.map(([name, value]) => `${name} ${value}`).join(", ");
    const label = `${this.part("h2").textContent}, step ${this.step} of ${this.steps}: ${words}`;
    this.part(".picture").setAttribute("aria-label", label);
  }

  // `length`: the steps of the longest episode that is shown, so that both have one time axis.
  setLength(length) {
    this.length = length;
    drawChart(this.part(".chart"), this.details, length, offered.actors);
    moveChart(this.part(".chart"), this.step, length);
  }

  async judge(policy) {
    this.judged = policy;
    this.probabilities = null;
    this.show(this.step);
    const entry = offered.policies[policy];
    if (entry?.algorithm && entry.tasks.includes(this.details.task)) {
      const fields = { source: this.source, episode: this.number, policy };
      const found = await (await ask("probabilities", fields)).json();
      if (this.judged !== policy) return;
      this.probabilities = found;
    }
    this.show(this.step);
  }
}

// Files that are each preceded by their size in four bytes.
function split(buffer) {
  const view = new DataView(buffer);
  const files = [];
  for (let at = 0; at < buffer.byteLength;) {
    const size = view.getUint32(at);
    files.push(new Blob([buffer.slice(at + 4, at + 4 + size)], { type: "image/webp" }));
    at += 4 + size;
  }
  return files;
}
