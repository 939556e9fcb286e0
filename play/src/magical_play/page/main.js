// The page: which of its two parts is shown, and what they share.

import { element, loadNames } from "./common.js";
import * as input from "./input.js";
import * as look from "./look.js";
import * as play from "./play.js";

const PAGES = ["play", "look"];
let shown = null;

function showPage() {
  const wanted = PAGES.includes(location.hash.slice(1)) ? location.hash.slice(1) : "play";
  if (wanted === shown) return;
  shown = wanted;
  for (const name of PAGES) {
    element(name).hidden = name !== wanted;
    if (name === wanted) element(`to-${name}`).setAttribute("aria-current", "page");
    else element(`to-${name}`).removeAttribute("aria-current");
  }
  document.body.dataset.page = wanted;
  document.title = `MAGICAL: ${wanted}`;
  if (wanted === "play") enterPlay();
  else enterLook();
}

// An environment is taken only when the page is played on.
function enterPlay() {
  look.stop();
  if (!play.socket) {
    play.say("Connecting…");
    play.connect();
  }
  play.fillWho();
  element("stage").focus();
}

function enterLook() {
  input.release();
  play.send({ type: "pause" });
  look.refresh();
}

function keyDown(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (shown === "play") input.keyDown(event);
  else look.keyDown(event);
}

async function start() {
  document.addEventListener("keydown", keyDown);
  document.addEventListener("keyup", input.keyUp);
  window.addEventListener("hashchange", showPage);
  play.bind();
  look.bind();
  try {
    await loadNames();
  } catch (error) {
    play.say(error.message || "The server is not responding. Reload to try again.", "lost");
    return;
  }
  showPage();
}

start();
