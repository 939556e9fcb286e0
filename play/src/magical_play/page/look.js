// Looking at episodes: the list, one or two panes, and the time that they share.

import {
  ask, element, envId, fill, fillTasks, fillVariants, loadNames, make, offered,
  policyName,
} from "./common.js";
import { Pane } from "./pane.js";

const RATE = 8; // steps a second at speed 1

export const panes = []; // one or two
let listed = 0; // episodes in the list
let step = 0; // of the panes; fractional while playing
let before = null; // the time of the last animation frame; null: stopped

function say(text) {
  element("look-status").textContent = text;
}

// Runs what may be refused, and says why.
async function attempt(work) {
  try {
    return await work();
  } catch (error) {
    say(error.message || "The server is not responding.");
    return null;
  }
}

// The list

async function list(skip) {
  const source = element("source").value;
  const task = element("shown-task").value;
  const answer = await attempt(async () => (await ask("episodes", { source, task, skip })).json());
  if (source !== element("source").value || task !== element("shown-task").value) return;
  if (!skip) {
    element("episodes").replaceChildren();
    element("more").hidden = true;
  }
  if (!answer) return;
  const { total, episodes } = answer;
  listed = skip + episodes.length;
  element("episodes").append(...episodes.map((episode) => makeLine(source, episode)));
  if (!total) element("episodes").append(make("li", { class: "faint" }, "No episodes yet."));
  element("more").hidden = listed >= total;
  markOpen();
}

function makeLine(source, episode) {
  const title = episode.env_id.replace(/^magical\/|-v0$/g, "").replace("-", " ");
  const score = (episode.score ?? episode.published_code_score).toFixed(2);
  const about = [`score ${score}`, episode.demonstrator,
    episode.seed === null ? null : `seed ${episode.seed}`].filter(Boolean).join(" · ");
  const opener = make("button", { type: "button", class: "open" },
    make("strong", {}, title), make("span", { class: "faint" }, about));
  const beside = make("button", { type: "button", "aria-label": `Compare ${title}, ${about}` },
    "Compare");
  opener.addEventListener("click", () => open(source, episode.number, false));
  beside.addEventListener("click", () => open(source, episode.number, true));
  return make("li", { "data-episode": `${source} ${episode.number}` }, opener, beside);
}

function markOpen() {
  const shown = panes.map((pane) => `${pane.source} ${pane.number}`);
  for (const line of element("episodes").querySelectorAll("[data-episode]")) {
    const at = shown.indexOf(line.dataset.episode);
    const opener = line.querySelector(".open");
    opener.toggleAttribute("data-shown", at >= 0);
    if (at >= 0) opener.setAttribute("aria-current", "true");
    else opener.removeAttribute("aria-current");
  }
}

// Panes

export async function open(source, number, beside) {
  const name = beside && panes.length ? "Second episode" : "First episode";
  const pane = await attempt(() => Pane.open(source, number, name));
  if (!pane) return;
  for (const old of panes.splice(beside ? 1 : 0)) old.close();
  panes.push(pane);
  pane.part(".close").addEventListener("click", () => close(pane));
  pane.part(".chart").addEventListener("click", (event) => {
    const box = event.currentTarget.getBoundingClientRect();
    go(Math.round((length() * (event.clientX - box.left)) / box.width));
  });
  element("panes").append(pane.root);
  say(`${pane.root.getAttribute("aria-label")}, ${pane.steps} steps.`);
  arrange();
  if (panes.length === 1) go(0);
  choosePolicy(pane);
  load(pane);
  if (matchMedia("(max-width: 46rem)").matches) element("viewer").scrollIntoView();
}

function close(pane) {
  panes.splice(panes.indexOf(pane), 1);
  pane.close();
  arrange();
  (panes[0]?.part(".close") ?? element("source")).focus();
}

function arrange() {
  element("transport").hidden = !panes.length;
  element("panes").classList.toggle("two", panes.length === 2);
  element("step").max = length();
  for (const pane of panes) pane.setLength(length());
  markOpen();
  if (!panes.length) stop();
  go(step);
}

function length() {
  return Math.max(0, ...panes.map((pane) => pane.steps));
}

function load(pane) {
  attempt(() => pane.load(element("look-view").value));
}

// The policy whose probabilities are shown: the episode's own, where it is known and a run.
function choosePolicy(pane) {
  const own = offered.policies.find(
    (policy) => policy.algorithm && [pane.details.policy, pane.details.demonstrator]
      .includes(policy.name),
  );
  if (!own || element("judge").value) return judge(pane);
  element("judge").value = own.number;
  panes.forEach(judge);
}

function judge(pane) {
  attempt(() => pane.judge(element("judge").value));
}

// Time

export function go(to) {
  step = Math.max(0, Math.min(to, length()));
  const whole = Math.floor(step);
  for (const pane of panes) if (pane.step !== whole || !pane.painted) pane.show(whole);
  element("step").value = whole;
  element("step").setAttribute("aria-valuetext", `step ${whole} of ${length()}`);
  element("step-number").textContent = `${whole} of ${length()}`;
}

export function stop() {
  before = null;
  element("run").textContent = "Play";
}

function run() {
  if (before !== null) return stop();
  if (step >= length()) go(0);
  before = performance.now();
  element("run").textContent = "Stop";
  requestAnimationFrame(tick);
}

function tick(now) {
  if (before === null) return;
  const next = step + (RATE * Number(element("speed").value) * Math.max(0, now - before)) / 1000;
  before = now;
  if (panes.every((pane) => pane.has(Math.floor(next)))) go(next); // else wait for the frames
  if (step >= length()) stop();
  else requestAnimationFrame(tick);
}

const KEYS = {
  " ": run,
  ArrowLeft: () => go(Math.floor(step) - 1),
  ArrowRight: () => go(Math.floor(step) + 1),
  Home: () => go(0),
  End: () => go(length()),
};

export function keyDown(event) {
  if (!panes.length || !(event.key in KEYS) || event.target.matches("input, select")) return;
  if (event.key === " " && event.target.matches("button")) return; // which it presses
  event.preventDefault();
  KEYS[event.key]();
}

// Rollouts

function fillRollout() {
  const policy = offered.policies[element("policy").value];
  fillTasks(element("rollout-task"), policy?.tasks ?? []);
  fillVariants(element("rollout-variant"), element("rollout-task").value);
}

async function rollOut(event) {
  event.preventDefault();
  const seed = element("rollout-seed");
  const wanted = {
    policy: Number(element("policy").value),
    env_id: envId(element("rollout-task").value, element("rollout-variant").value),
    seed: seed.value === "" ? null : seed.valueAsNumber,
  };
  say("Rolling out…");
  const made = await attempt(async () => {
    const options = { method: "POST", body: JSON.stringify(wanted) };
    return (await ask("rollouts", {}, options)).json();
  });
  if (!made) return;
  element("source").value = made.source;
  element("shown-task").value = "";
  await list(0);
  await open(made.source, made.episode, false);
}

function fillNames() {
  const tasks = offered.tasks.map((task) => [task.name, task.name]);
  fill(element("shown-task"), [["", "all"], ...tasks]);
  fill(element("source"), offered.sources.map(({ key, name }) => [key, name]));
  const named = offered.policies.map((policy) => [policy.number, policyName(policy)]);
  fill(element("policy"), named);
  const runs = named.filter(([number]) => offered.policies[number].algorithm);
  fill(element("judge"), [["", "no policy"], ...runs]);
  element("judge-label").hidden = !runs.length;
  fillRollout();
}

// Shows the list anew, with episodes and runs that were added meanwhile.
export async function refresh() {
  await attempt(async () => {
    await loadNames();
    fillNames();
    await list(0);
  });
}

export function bind() {
  element("find").addEventListener("submit", (event) => event.preventDefault());
  element("source").addEventListener("change", () => list(0));
  element("shown-task").addEventListener("change", () => list(0));
  element("more").addEventListener("click", async () => {
    element("more").disabled = true;
    try {
      await list(listed);
    } finally {
      element("more").disabled = false;
    }
  });
  element("reload").addEventListener("click", refresh);
  element("policy").addEventListener("change", fillRollout);
  element("rollout-task").addEventListener("change", () => {
    fillVariants(element("rollout-variant"), element("rollout-task").value);
  });
  element("rollout").addEventListener("submit", rollOut);
  element("step").addEventListener("input", () => { stop(); go(element("step").valueAsNumber); });
  element("run").addEventListener("click", run);
  for (const [id, key] of [["first", "Home"], ["back", "ArrowLeft"], ["forward", "ArrowRight"],
    ["last", "End"]]) {
    element(id).addEventListener("click", () => { stop(); KEYS[key](); });
  }
  element("look-view").addEventListener("change", () => panes.forEach(load));
  element("judge").addEventListener("change", () => panes.forEach(judge));
}
