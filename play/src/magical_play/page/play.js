// Playing and watching: the connection, and frames and status from the server.

import {
  element, envId, fill, fillTasks, fillVariants, inWords, offered, policyName, token,
} from "./common.js";
import { showGrid } from "./grid.js";
import * as input from "./input.js";

const CLOSED = {
  4001: "This session was opened in another tab.",
  4002: "The session ended because nothing was pressed for a long time. Reload to play again.",
  4003: "", // the reason came before
};
const GIVE_UP = 90; // seconds without a connection; the server keeps an episode for 60
const MAX_WAIT = 4; // seconds between two attempts to connect

export let socket = null;
export let latest = null; // the newest status from the server
let lostSince = null;
let wait = 0.25;
let decoding = Promise.resolve(); // of the frames so far; one that fails leaves the others alone

// The connection

export function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const query = new URLSearchParams({ token });
  const session = sessionStorage.getItem("session");
  if (session) query.set("session", session);
  socket = new WebSocket(`${scheme}://${location.host}/socket?${query}`);
  socket.binaryType = "blob";
  socket.onmessage = receive;
  socket.onclose = lost;
}

function receive(event) {
  if (typeof event.data !== "string") return showFrame(event.data, latest);
  const message = JSON.parse(event.data);
  if (message.type === "status") showStatus(message);
  if (message.type === "refused") say(`Not started: ${message.reason}.`, "lost");
  if (message.type === "hello") greet(message.session);
}

function greet(session) {
  sessionStorage.setItem("session", session);
  lostSince = null;
  wait = 0.25;
  input.forgetSent();
  say("Connected", "good");
  const view = localStorage.getItem("view");
  if (view) send({ type: "view", view });
}

function lost(event) {
  if (event.code in CLOSED) {
    sessionStorage.removeItem("session");
    return CLOSED[event.code] && say(CLOSED[event.code], "lost");
  }
  lostSince ??= performance.now();
  if ((performance.now() - lostSince) / 1000 > GIVE_UP) {
    return say("No connection. Open the address that the server printed.", "lost");
  }
  say("Connection lost, trying again. The episode is kept for a minute.", "lost");
  setTimeout(connect, 1000 * wait);
  wait = Math.min(MAX_WAIT, 2 * wait);
}

export function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

export function say(text, state) {
  element("connection").textContent = text;
  element("connection").dataset.state = state;
}

// Frames and status

function showFrame(blob, shown) {
  decoding = decoding.catch(() => {}).then(async () => {
    const image = await createImageBitmap(blob);
    const canvas = element("frame");
    if (canvas.width !== image.width) {
      canvas.width = image.width;
      document.body.classList.toggle("wide", image.width > image.height);
    }
    canvas.getContext("2d").drawImage(image, 0, 0);
    input.sendKeys(shown.number);
  });
}

function showStatus(message) {
  const before = latest;
  latest = message;
  element("time").value = message.steps / message.horizon;
  element("seconds").textContent = `${message.seconds_left.toFixed(1)} s`;
  element("score").textContent = message.score.toFixed(2);
  element("score").toggleAttribute("data-good", message.score === 1);
  showExecuted(message.executed);
  element("notice").textContent = message.notice;
  const choosing = deciding();
  element("decision").hidden = !choosing;
  element("pause").disabled = message.phase !== "playing" && message.phase !== "paused";
  element("pause-text").textContent = message.phase === "paused" ? "Resume" : "Pause";
  element("restart").disabled = element("new").disabled = choosing || message.phase === "saving";
  element("name-label").hidden = !message.recording;
  element("view").value = message.view;
  if (message.recording) say(`Recording; ${message.kept} kept`, "good");
  showPolicy(before, message);
  const turned = before?.policy_acts !== message.policy_acts;
  if (turned || before?.phase !== message.phase || before?.seed !== message.seed) showPhase(message);
  if (before?.env_id !== message.env_id) showEnvironment();
  const seen = `${message.task} ${message.variant}, seed ${message.seed}, ${message.phase}`;
  element("frame").setAttribute("aria-label", seen);
}

function deciding() {
  return latest?.phase === "ended" && latest.can_keep;
}

function showExecuted(executed) {
  element("action").textContent = inWords(executed);
  for (const button of document.querySelectorAll("[data-control]")) {
    button.toggleAttribute("data-lit", executed?.includes(button.dataset.control) ?? false);
  }
}

function showPhase(message) {
  const { phase, score, seed, policy_name: policy } = message;
  const key = matchMedia("(pointer: coarse)").matches ? "button" : "key";
  const text = {
    ready: `Seed ${seed}. Press a ${key} to begin.`,
    paused: policy ? `Paused. Resume to continue, hand back to let ${policy} act; a ${key} takes over.`
      : `Paused. Resume, or press a ${key}, to continue.`,
    ended: `Episode over: score ${score.toFixed(2)}.${
      deciding() ? " Keep this episode?" : " Start over, or try a new scene."}`,
    saving: "Saving…",
  }[phase];
  element("prompt").hidden = !text;
  element("prompt-text").textContent = text ?? "";
}

// The policy that is watched: who acts, what it would do.
function showPolicy(before, message) {
  const { policy, policy_name: name, policy_acts: acts, phase } = message;
  element("watching").hidden = policy === null;
  element("who").value = policy ?? "";
  if (policy === null) return;
  const going = phase === "playing" || phase === "paused";
  element("hand-back").disabled = !going || (acts && phase === "playing");
  if (before?.policy_acts !== acts || before?.policy !== policy) {
    element("acting").textContent = acts ? `${name} is acting. Any control takes over.`
      : `You are acting, until you hand back to ${name}.`;
    element("watching").toggleAttribute("data-human", !acts);
  }
  if (message.proposed) {
    element("proposed").textContent = inWords(message.proposed);
    showGrid(element("live-grid"), message.probabilities);
  }
}

function showEnvironment() {
  if (!latest || !offered.tasks.length) return;
  const task = offered.tasks.find((one) => one.name === latest.task);
  element("goal").textContent = task?.summary ?? latest.task;
  fillTasks(element("task"), undefined, latest.task);
  fillVariants(element("variant"), latest.task, latest.variant);
  fillWho();
}

// Who can act in this task.
export function fillWho() {
  const able = offered.policies.filter(({ tasks }) => tasks.includes(latest?.task));
  const names = able.map((policy) => [policy.number, policyName(policy)]);
  fill(element("who"), [["", "you"], ...names], latest?.policy ?? "");
}

// What buttons and keys ask for

const COMMANDS = {
  r: () => send({ type: "restart" }),
  n: () => latest && send({ type: "start", env_id: latest.env_id, seed: null }),
  p: () => send({ type: latest?.phase === "paused" ? "resume" : "pause" }),
  h: () => latest?.policy !== null && send({ type: "hand_back" }),
  k: () => deciding() && keep(),
  d: () => deciding() && send({ type: "discard" }),
};

function keep() {
  send({ type: "keep", demonstrator: element("name").value.trim() || "player" });
}

function start(event) {
  event.preventDefault();
  const env_id = envId(element("task").value, element("variant").value);
  const seed = element("seed").value === "" ? null : element("seed").valueAsNumber;
  if (env_id) send({ type: "start", env_id, seed });
  element("stage").focus();
}

function watch() {
  const chosen = element("who").value;
  send({ type: "watch", policy: chosen === "" ? null : Number(chosen) });
  element("stage").focus();
}

function bindButton(id, act) {
  element(id).addEventListener("click", () => {
    act();
    element("stage").focus();
  });
}

function remember(id) {
  element(id).addEventListener("change", () => localStorage.setItem(id, element(id).value));
}

export function bind() {
  input.bind(send, COMMANDS);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) send({ type: "pause" });
  });
  for (const [id, key] of [["restart", "r"], ["new", "n"], ["pause", "p"], ["keep", "k"],
    ["discard", "d"], ["hand-back", "h"]]) {
    bindButton(id, COMMANDS[key]);
  }
  element("choose").addEventListener("submit", start);
  element("task").addEventListener("change", () => {
    fillVariants(element("variant"), element("task").value);
  });
  element("who").addEventListener("change", watch);
  element("view").addEventListener("change", () => {
    send({ type: "view", view: element("view").value });
  });
  element("name").value = localStorage.getItem("name") ?? "";
  remember("view");
  remember("name");
}
