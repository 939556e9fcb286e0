// The page: the connection, frames and status from the server, what buttons and keys ask for.

import * as input from "./input.js";

const REPLACED = 4001; // the close code when the page was opened elsewhere
const RETRY = 1000; // ms between two attempts to connect

const token = new URLSearchParams(location.search).get("token") ?? "";
const element = (id) => document.getElementById(id);

export let socket = null;
export let latest = null; // the newest status
export let shown = 0; // the number of the newest frame
let offer = null; // what the server offers
let decoding = Promise.resolve(); // of the frames so far; one that fails leaves the others alone

// The connection

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}/socket?${new URLSearchParams({ token })}`);
  socket.binaryType = "blob";
  socket.onmessage = receive;
  socket.onclose = lost;
}

function receive({ data }) {
  if (typeof data !== "string") return showFrame(data, latest.number);
  const message = JSON.parse(data);
  ({ offer: showOffer, episodes: showEpisodes, status: showStatus })[message.type](message);
}

function lost({ code }) {
  latest = null;
  if (code === REPLACED) return say("Opened elsewhere. Reload to continue here.", "lost");
  say("No connection, trying again. Was the server started anew? Open the address it printed.",
    "lost");
  setTimeout(connect, RETRY);
}

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function say(text, state) {
  element("connection").textContent = text;
  element("connection").dataset.state = state;
}

// What the server sends

function fill(select, options, chosen = select.value) {
  select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  if (options.some(([value]) => String(value) === String(chosen))) select.value = chosen;
}

function fillVariants(chosen) {
  const variants = Object.keys(offer.tasks[element("task").value] ?? {});
  fill(element("variant"), variants.map((name) => [name, name]), chosen);
}

function showOffer(message) {
  offer = message;
  input.forgetSent();
  say("Connected", "good");
  fill(element("task"), Object.keys(offer.tasks).map((name) => [name, name]));
  fill(element("who"), [["", "you"], ...offer.policies.entries()]);
  fill(element("dataset"), [...offer.datasets.entries()]);
  element("recorded").hidden = !offer.datasets.length;
  listEpisodes();
  show();
}

function listEpisodes() {
  const dataset = Number(element("dataset").value);
  if (offer.datasets.length) send({ type: "watch", dataset, episode: null });
}

function showEpisodes({ dataset, episodes }) {
  if (dataset !== Number(element("dataset").value)) return;
  fill(element("episodes"), episodes.map(([number, task, variant, score, by, seed]) =>
    [number, `${task} ${variant}, ${score.toFixed(2)}, ${by}, seed ${seed ?? "unknown"}`]));
}

function showFrame(blob, number) {
  decoding = decoding.catch(() => {}).then(async () => {
    const image = await createImageBitmap(blob);
    const canvas = element("frame");
    if (canvas.width !== image.width) canvas.width = image.width;
    if (canvas.height !== image.height) canvas.height = image.height;
    document.body.classList.toggle("wide", image.width > image.height);
    canvas.getContext("2d").drawImage(image, 0, 0);
    shown = number;
    input.sendKeys(number);
  });
}

function showStatus(message) {
  const before = latest;
  latest = message;
  const { phase, is_recorded: recorded, can_keep: deciding } = message;
  element("goal").textContent = message.goal;
  element("step").max = message.length;
  element("step").value = message.steps;
  element("step").disabled = !recorded;
  element("facts").replaceChildren(...Object.entries(message.facts).map(([name, value]) => {
    const parts = ["div", "dt", "dd"].map((tag) => document.createElement(tag));
    [parts[1].textContent, parts[2].textContent] = [name, value];
    parts[0].append(parts[1], parts[2]);
    return parts[0];
  }));
  for (const button of document.querySelectorAll("[data-control]")) {
    button.toggleAttribute("data-lit", message.executed.includes(button.dataset.control));
    button.disabled = recorded;
  }
  element("notice").textContent = message.notice;
  element("decision").hidden = !deciding;
  element("pause").disabled = !canPause();
  element("pause-text").textContent = phase === "playing" ? "Pause" : "Resume";
  element("restart").disabled = element("new").disabled = deciding;
  element("name-label").hidden = !message.recording;
  if (message.recording) say(`Recording; ${message.kept} kept`, "good");
  showPolicy(message);
  showPrompt(message);
  if (before?.env_id !== message.env_id) {
    element("task").value = message.task;
    fillVariants(message.variant);
  }
  if (before?.policy !== message.policy) element("who").value = message.policy ?? "";
  if (before && before.kept !== message.kept) listEpisodes();
  const seen = `${message.task} ${message.variant}, seed ${message.seed}, ${phase}`;
  element("frame").setAttribute("aria-label", seen);
}

function canPause() {
  return ["playing", "paused"].includes(latest?.phase) || (latest?.is_recorded ?? false);
}

function showPrompt({ phase, facts, seed, is_recorded, can_keep, policy_name: policy }) {
  const text = is_recorded ? "" : {
    ready: `Seed ${seed}. Press a key or a button to begin.`,
    paused: policy ? `Paused. Resume to continue, hand back to let ${policy} act; a key takes over.`
      : "Paused. Resume, or press a key, to continue.",
    ended: `Episode over: score ${facts.Score}.${
      can_keep ? " Keep this episode?" : " Start over, or try a new scene."}`,
  }[phase] ?? "";
  element("prompt").hidden = !text;
  if (element("prompt-text").textContent !== text) element("prompt-text").textContent = text;
}

// The policy that is watched: who acts, what it would do.
function showPolicy({ policy, policy_name: name, policy_acts: acts, phase, proposed }) {
  element("watching").hidden = policy === null;
  if (policy === null) return;
  element("hand-back").disabled = phase === "ended" || (acts && phase === "playing");
  const text = acts ? `${name} is acting. Any control takes over.`
    : `You are acting, until you hand back to ${name}.`;
  if (element("acting").textContent !== text) element("acting").textContent = text;
  element("watching").toggleAttribute("data-human", !acts);
  element("proposed").textContent = proposed;
}

// What buttons and keys ask for

function press(button) {
  send({ type: "press", button });
}

function start(env_id, seed, policy) {
  if (env_id) send({ type: "start", env_id, seed, policy });
}

function pause() {
  if (latest?.is_recorded && latest.phase === "ended") return press("restart");
  if (canPause()) press(latest.phase === "playing" ? "pause" : "resume");
}

function seek(step) {
  send({ type: "seek", step: Math.max(0, step) });
}

const COMMANDS = {
  r: () => press("restart"),
  n: () => latest && start(latest.env_id, null, latest.policy),
  p: pause,
  h: () => latest?.policy !== null && press("hand_back"),
  k: () => latest?.can_keep
    && send({ type: "keep", demonstrator: element("name").value.trim() || "player" }),
  d: () => latest?.can_keep && press("discard"),
};

const RECORDED_COMMANDS = {
  " ": pause,
  ArrowLeft: () => seek(latest.steps - 1),
  ArrowRight: () => seek(latest.steps + 1),
  Home: () => seek(0),
  End: () => seek(latest.length),
};

function command(key) {
  const act = (latest?.is_recorded && RECORDED_COMMANDS[key]) || COMMANDS[key.toLowerCase()];
  act?.();
  return Boolean(act);
}

function show() {
  const [view, speed] = [element("view").value, Number(element("speed").value)];
  send({ type: "show", view, speed });
}

function submit(event) {
  event.preventDefault();
  const seed = element("seed").value === "" ? null : element("seed").valueAsNumber;
  const who = element("who").value === "" ? null : Number(element("who").value);
  start(offer?.tasks[element("task").value]?.[element("variant").value], seed, who);
  element("stage").focus();
}

function on(id, event, act) {
  element(id).addEventListener(event, act);
}

input.bind(send, command);
for (const [id, key] of [["restart", "r"], ["new", "n"], ["pause", "p"], ["keep", "k"],
  ["discard", "d"], ["hand-back", "h"]]) {
  on(id, "click", () => {
    COMMANDS[key]();
    element("stage").focus();
  });
}
on("choose", "submit", submit);
on("task", "change", () => fillVariants());
on("dataset", "change", listEpisodes);
on("episodes", "change", () => {
  const [dataset, episode] = ["dataset", "episodes"].map((id) => Number(element(id).value));
  send({ type: "watch", dataset, episode });
});
on("step", "input", () => seek(element("step").valueAsNumber));
for (const id of ["speed", "view"]) on(id, "change", show);
for (const id of ["view", "name"]) {
  element(id).value = localStorage.getItem(id) ?? element(id).value;
  on(id, "change", () => localStorage.setItem(id, element(id).value));
}
document.addEventListener("visibilitychange", () => document.hidden && press("pause"));
element("stage").focus();
connect();
