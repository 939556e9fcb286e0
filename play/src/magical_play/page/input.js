// Keys, touch, gamepad: whatever holds a control.

const KEYS = {
  ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right", " ": "grip",
};
const sources = { keys: new Set(), touch: new Set(), gamepad: new Set() };
let sentHeld = "";
let send = () => {}; // a message to the server
let command = () => false; // does what another key asks for, and says whether it means anything

const isField = (target) => target.matches("input, select, button");

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

function release() {
  for (const source of Object.values(sources)) source.clear();
  sendKeys();
}

function hold(source, control, down) {
  if (down) sources[source].add(control);
  else sources[source].delete(control);
  sendKeys();
}

function keyDown(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") return document.getElementById("stage").focus();
  if (isField(event.target)) return;
  if (event.repeat ? event.key in KEYS : command(event.key)) return event.preventDefault();
  if (!(event.key in KEYS)) return;
  event.preventDefault();
  hold("keys", KEYS[event.key], true);
}

function keyUp(event) {
  if (event.key in KEYS) hold("keys", KEYS[event.key], false);
}

function bindPad(button) {
  const press = (down) => hold("touch", button.dataset.control, down);
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

export function bind(sender, commands) {
  send = sender;
  command = commands;
  document.addEventListener("keydown", keyDown);
  document.addEventListener("keyup", keyUp);
  window.addEventListener("blur", release);
  document.addEventListener("focusin", (event) => isField(event.target) && release());
  window.addEventListener("gamepadconnected", () => requestAnimationFrame(readGamepads));
  document.querySelectorAll("[data-control]").forEach(bindPad);
}
