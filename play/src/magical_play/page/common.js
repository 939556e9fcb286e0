// What the parts of the page share: the server's answers, names, small helpers.

export const token = new URLSearchParams(location.search).get("token") ?? "";
export const element = (id) => document.getElementById(id);

// Filled by `loadNames`: what the server offers.
export const offered = { tasks: [], policies: [], sources: [], actions: [], actors: [] };

export class Refused extends Error {
  constructor(status, problem) {
    super(problem);
    this.status = status;
  }
}

export async function ask(path, fields = {}, options = {}) {
  const answer = await fetch(`/api/${path}?${new URLSearchParams({ token, ...fields })}`, options);
  if (answer.ok) return answer;
  const text = await answer.text();
  let problem = text;
  try {
    problem = JSON.parse(text).problem;
  } catch { /* refused before any route: plain text */ }
  throw new Refused(answer.status, problem);
}

export async function loadNames() {
  Object.assign(offered, await (await ask("library")).json());
}

export function fill(select, options, chosen = select.value) {
  select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  if (options.some(([value]) => String(value) === String(chosen))) select.value = chosen;
}

// A policy's name, with its algorithm where that is not said already.
export function policyName({ name, algorithm }) {
  return !algorithm || name.toLowerCase().includes(algorithm) ? name : `${name} (${algorithm})`;
}

export function fillTasks(select, names = offered.tasks.map((task) => task.name), chosen) {
  fill(select, names.map((name) => [name, name]), chosen);
}

export function fillVariants(select, task, chosen) {
  const found = offered.tasks.find((one) => one.name === task);
  fill(select, Object.keys(found?.env_ids ?? {}).map((name) => [name, name]), chosen);
}

export function envId(task, variant) {
  return offered.tasks.find((one) => one.name === task)?.env_ids[variant];
}

// Controls in words; an action is given by its controls, `null` where there is none.
export function inWords(controls) {
  return controls?.length ? controls.join(" + ") : controls ? "none" : "–";
}

// An action's number, or the parts of a continuous one; nothing: no more action.
export function actionInWords(action) {
  if (!Array.isArray(action)) return inWords(offered.actions[action]?.controls ?? null);
  const [drive, turn, grip] = action.map((part) => part.toFixed(2));
  return `drive ${drive}, turn ${turn}, grip ${grip}`;
}

export function isField(target) {
  return target.matches("input, select, button");
}

export function make(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
