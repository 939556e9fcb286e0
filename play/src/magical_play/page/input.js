// Keys, touch, gamepad: whatever holds a control.

import { element, isField } from "./common.js";

const KEYS = {
  ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right", " ": "grip",
};
const sources = { keys: new Set(), touch: new Set(), gamepad: new Set() };
let sentHeld = "";
let send = () => {}; // a message to the server
let commands = {}; // what other keys do

function held() {
  return [...new Set(Object.values(sources).flatMap((source) => [...source]))].sort();
}

// `seen`: the number of the frame that is shown; without it, sent only where keys have changed.
export function sendKeys(seen) {
  const controls = held();
  if (seen === undefined && controls.join() === sentHeld) return;
  sentHeld = controls.join();
  send({ type: "keys", held: controls, seen: seen ?? 0 });
}

// A new connection: the server knows of no keys.
export function forgetSent() {
  sentHeld = "";
}

export function release() {
  for (const source of Object.values(sources)) source.clear();
  sendKeys();
}

function hold(source, control, down) {
  if (down) sources[source].add(control);
  else sources[source].delete(control);
  sendKeys();
}

export function keyDown(event) {
  if (event.key === "Escape") return element("stage").focus();
  if (isField(event.target)) return;
  const control = KEYS[event.key];
  if (control) {
    event.preventDefault();
    if (!event.repeat) hold("keys", control, true);
  } else if (!event.repeat) {
    commands[event.key.toLowerCase()]?.();
  }
}

export function keyUp(event) {
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
  const played = document.body.dataset.page === "play";
  sources.gamepad = new Set(Object.keys(states).filter((control) => played && states[control]));
  sendKeys();
  if (pads.length) requestAnimationFrame(readGamepads);
}

export function bind(sender, named) {
  send = sender;
  commands = named;
  window.addEventListener("blur", release);
  document.addEventListener("focusin", (event) => isField(event.target) && release());
  window.addEventListener("gamepadconnected", () => requestAnimationFrame(readGamepads));
  document.querySelectorAll("[data-control]").forEach(bindPad);
}
