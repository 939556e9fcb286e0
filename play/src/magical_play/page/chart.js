// The course of an episode in one line: the score of each state, and below it who acted.

const WIDTH = 400;
const TOP = 4;
const BOTTOM = 44; // of the score's line; below it are the actors
const BAND = [{ y: 50, height: 4 }, { y: 50, height: 4 }, { y: 47, height: 10 }];

function draw(svg, name, attributes) {
  const made = document.createElementNS(svg.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

// `actors` names those that `episode.actors` numbers; people's steps stand out by height too.
export function drawChart(svg, episode, length, actors) {
  const x = (step) => (WIDTH * step) / Math.max(1, length);
  const y = (score) => BOTTOM - score * (BOTTOM - TOP);
  const parts = [TOP, BOTTOM].map((at) =>
    draw(svg, "line", { class: "rule", x1: 0, x2: WIDTH, y1: at, y2: at }));
  if (episode.scores) {
    const points = episode.scores.map((score, step) => `${x(step)},${y(score)}`).join(" ");
    parts.push(draw(svg, "polyline", { class: "score", points }));
  }
  episode.actors?.forEach((actor, step) => {
    const place = { x: x(step), width: x(1), ...BAND[actor] };
    parts.push(draw(svg, "rect", { class: `by-${actors[actor]}`, ...place }));
  });
  parts.push(draw(svg, "line", { class: "now", x1: 0, x2: 0, y1: 0, y2: 60 }));
  svg.replaceChildren(...parts);
}

export function moveChart(svg, step, length) {
  const at = (WIDTH * step) / Math.max(1, length);
  const now = svg.querySelector(".now");
  now?.setAttribute("x1", at);
  now?.setAttribute("x2", at);
}
