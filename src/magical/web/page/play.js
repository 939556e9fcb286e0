// The page's side of playing: keys to the server, frames and status from it.
"use strict";

const token = new URLSearchParams(location.search).get("token") ?? "";
const element = (id) => document.getElementById(id);
const KEYS = {
  ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right", " ": "grip",
};
const CLOSED = {
  4001: "This session was opened in another tab.",
  4002: "The session ended because nothing was pressed for a long time. Reload to play again.",
  4003: "", // the reason came before
};
const GIVE_UP = 90; // seconds without a connection; the server keeps an episode for 60
const MAX_WAIT = 4; // seconds between two attempts to connect

let socket = null;
let lostSince = null;
let wait = 0.25;
let latest = null; // the newest status from the server
let tasks = [];
let decoding = Promise.resolve();
const sources = { keys: new Set(), touch: new Set(), gamepad: new Set() };
let sentHeld = "";

// The connection

function connect() {
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
  sentHeld = "";
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

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function say(text, state) {
  element("connection").textContent = text;
  element("connection").dataset.state = state;
}

// Frames and status

function showFrame(blob, shown) {
  decoding = decoding.then(async () => {
    const image = await createImageBitmap(blob);
    const canvas = element("frame");
    if (canvas.width !== image.width) {
      canvas.width = image.width;
      document.body.classList.toggle("wide", image.width > image.height);
    }
    canvas.getContext("2d").drawImage(image, 0, 0);
    sendKeys(shown.number);
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
  const deciding = message.phase === "ended" && message.recording;
  element("decision").hidden = !deciding;
  element("pause").disabled = message.phase !== "playing";
  element("restart").disabled = element("new").disabled = deciding || message.phase === "saving";
  element("name-label").hidden = !message.recording;
  element("view").value = message.view;
  if (message.recording) say(`Recording; ${message.kept} kept`, "good");
  if (before?.phase !== message.phase) showPhase(message);
  if (before?.env_id !== message.env_id) showEnvironment();
  const seen = `${message.task} ${message.variant}, seed ${message.seed}, ${message.phase}`;
  element("frame").setAttribute("aria-label", seen);
}

function showExecuted(executed) {
  const names = executed?.length ? executed.join(" + ") : executed ? "none" : "–";
  element("action").textContent = names;
  for (const button of document.querySelectorAll("[data-control]")) {
    button.toggleAttribute("data-lit", executed?.includes(button.dataset.control) ?? false);
  }
}

function showPhase({ phase, score, recording, seed }) {
  const key = matchMedia("(pointer: coarse)").matches ? "button" : "key";
  const text = {
    ready: `Seed ${seed}. Press a ${key} to begin.`,
    paused: `Paused. Press a ${key} to go on.`,
    ended: `The end: score ${score.toFixed(2)}.${recording ? " Keep this episode?" : ""}`,
    saving: "Saving…",
  }[phase];
  element("prompt").hidden = !text;
  element("prompt-text").textContent = text ?? "";
}

function showEnvironment() {
  if (!latest || !tasks.length) return;
  const task = tasks.find((one) => one.name === latest.task);
  element("goal").textContent = task?.summary ?? latest.task;
  element("task").value = latest.task;
  fillVariants(latest.variant);
}

function fill(select, names) {
  select.replaceChildren(...names.map((name) => new Option(name, name)));
}

function fillVariants(chosen) {
  const task = tasks.find((one) => one.name === element("task").value);
  const names = Object.keys(task?.env_ids ?? {});
  fill(element("variant"), names);
  element("variant").value = names.includes(chosen) ? chosen : names[0];
}

// Keys, touch, gamepad: whatever holds a control

function held() {
  return [...new Set(Object.values(sources).flatMap((source) => [...source]))].sort();
}

function sendKeys(seen) {
  const controls = held();
  if (seen === undefined && controls.join() === sentHeld) return;
  sentHeld = controls.join();
  send({ type: "keys", held: controls, seen: seen ?? 0 });
}

function release() {
  for (const source of Object.values(sources)) source.clear();
  sendKeys();
}

function hold(source, control, down) {
  if (down) sources[source].add(control);
  else sources[source].delete(control);
  sendKeys();
}

const COMMANDS = {
  r: () => send({ type: "restart" }),
  n: () => latest && send({ type: "start", env_id: latest.env_id, seed: null }),
  p: () => send({ type: "pause" }),
  k: () => deciding() && keep(),
  d: () => deciding() && send({ type: "discard" }),
};

function deciding() {
  return latest?.phase === "ended" && latest.recording;
}

function keep() {
  send({ type: "keep", demonstrator: element("name").value.trim() || "player" });
}

function typing(target) {
  return target.matches("input, select, button") && !target.matches("[type=checkbox]");
}

function keyDown(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") return element("stage").focus();
  if (typing(event.target)) return;
  const control = KEYS[event.key];
  if (control) {
    event.preventDefault();
    if (!event.repeat) hold("keys", control, true);
  } else if (!event.repeat) {
    COMMANDS[event.key.toLowerCase()]?.();
  }
}

function keyUp(event) {
  if (event.key in KEYS) hold("keys", KEYS[event.key], false);
}

function bindPad(button) {
  const control = button.dataset.control;
  const press = (down) => hold("touch", control, down);
  button.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    press(true);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) {
    button.addEventListener(name, () => press(false));
  }
  for (const name of ["keydown", "keyup"]) {
    button.addEventListener(name, (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      press(name === "keydown");
    });
  }
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

function readGamepads() {
  const pads = navigator.getGamepads().filter(Boolean);
  const pressed = (index) => pads.some((pad) => pad.buttons[index]?.pressed);
  const axis = (index, sign) => pads.some((pad) => sign * (pad.axes[index] ?? 0) > 0.5);
  const states = {
    forward: pressed(12) || axis(1, -1),
    back: pressed(13) || axis(1, 1),
    left: pressed(14) || axis(0, -1),
    right: pressed(15) || axis(0, 1),
    grip: pressed(0) || pressed(7),
  };
  sources.gamepad = new Set(Object.keys(states).filter((control) => states[control]));
  sendKeys();
  if (pads.length) requestAnimationFrame(readGamepads);
}

// The rest of the page

function bindButton(id, act) {
  element(id).addEventListener("click", () => {
    act();
    element("stage").focus();
  });
}

function start(event) {
  event.preventDefault();
  const task = tasks.find((one) => one.name === element("task").value);
  const env_id = task?.env_ids[element("variant").value];
  const seed = element("seed").value === "" ? null : element("seed").valueAsNumber;
  if (env_id) send({ type: "start", env_id, seed });
  element("stage").focus();
}

function setPalette() {
  const safe = element("palette").checked;
  document.documentElement.dataset.palette = safe ? "safe" : "";
  localStorage.setItem("palette", safe ? "safe" : "");
}

async function loadTasks() {
  const answer = await fetch(`/api/environments?${new URLSearchParams({ token })}`);
  if (!answer.ok) return say(await answer.text(), "lost");
  tasks = (await answer.json()).tasks;
  fill(element("task"), tasks.map((task) => task.name));
  fillVariants();
  showEnvironment();
  connect();
}

function bind() {
  document.addEventListener("keydown", keyDown);
  document.addEventListener("keyup", keyUp);
  window.addEventListener("blur", release);
  document.addEventListener("focusin", (event) => typing(event.target) && release());
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) send({ type: "pause" });
  });
  window.addEventListener("gamepadconnected", () => requestAnimationFrame(readGamepads));
  document.querySelectorAll("[data-control]").forEach(bindPad);
  bindButton("restart", COMMANDS.r);
  bindButton("new", COMMANDS.n);
  bindButton("pause", COMMANDS.p);
  bindButton("keep", keep);
  bindButton("discard", () => send({ type: "discard" }));
  element("choose").addEventListener("submit", start);
  element("task").addEventListener("change", () => fillVariants(element("variant").value));
  element("view").addEventListener("change", () => {
    localStorage.setItem("view", element("view").value);
    send({ type: "view", view: element("view").value });
  });
  element("name").value = localStorage.getItem("name") ?? "";
  element("name").addEventListener("change", () => {
    localStorage.setItem("name", element("name").value);
  });
  element("palette").checked = localStorage.getItem("palette") === "safe";
  element("palette").addEventListener("change", setPalette);
  setPalette();
  element("stage").focus();
}

bind();
loadTasks().catch(() => say("The server does not answer. Reload to try again.", "lost"));
