// Action probabilities: what is driven by row, how it turns by column, for open and closed fingers.

import { inWords, make, offered } from "./common.js";

const ROWS = ["forward", "stop", "back"];
const COLUMNS = ["left", "straight", "right"];
const FINGERS = [["open", "Fingers open"], ["closed", "Grip"]];

function number(row, column, fingers) {
  return offered.actions.findIndex((action) => action.name === `${row}-${column}-${fingers}`);
}

// How much of the colour a cell has. The middle is left out, where neither dark nor white numbers
// could be read on it.
function shade(value) {
  return value > 0.45 ? 0.92 + 0.08 * value : 0.92 * Math.sqrt(value);
}

function percent(value) {
  return value < 0.005 ? "" : String(Math.round(100 * value));
}

function describe(probabilities) {
  const order = probabilities.map((value, action) => [value, action]).sort((a, b) => b[0] - a[0]);
  const parts = order.slice(0, 3).map(
    ([value, action]) => `${inWords(offered.actions[action].controls)} ${percent(value) || 0} %`,
  );
  return `Action probabilities: ${parts.join(", ")}`;
}

// Shows 18 probabilities in `parent`; the cell of `executed` is framed. `null`: nothing to show.
export function showGrid(parent, probabilities, executed = null) {
  parent.hidden = !probabilities;
  if (!probabilities) return;
  if (!parent.firstChild) parent.append(...FINGERS.map(makeTable));
  parent.setAttribute("role", "img");
  parent.setAttribute("aria-label", describe(probabilities));
  for (const cell of parent.querySelectorAll("[data-action]")) {
    const action = Number(cell.dataset.action);
    cell.textContent = percent(probabilities[action]);
    cell.style.setProperty("--share", shade(probabilities[action]).toFixed(3));
    cell.toggleAttribute("data-dark", probabilities[action] > 0.45);
    cell.toggleAttribute("data-executed", action === executed);
  }
}

function makeTable([fingers, title]) {
  const cells = ROWS.flatMap((row) => COLUMNS.map((column) => {
    const hint = `${row}, ${column}, ${title.toLowerCase()}`;
    return make("span", { "data-action": number(row, column, fingers), title: hint });
  }));
  const marks = [["", "◀", "", "▶"], ["▲"], ["■"], ["▼"]];
  const top = marks[0].map((mark) => make("b", {}, mark));
  const rows = ROWS.flatMap((_, i) => [
    make("b", {}, marks[i + 1][0]), ...cells.slice(3 * i, 3 * i + 3),
  ]);
  return make("div", { class: "probabilities" }, make("em", {}, `${title}, %`), ...top, ...rows);
}
