// Facts about a run: its progress, its results, its settings, and the command that repeats it.

import { button, element } from "./dom.js";
import { count, date, duration, percent, short } from "./format.js";

// The parts of a summary's times that follow each other; the others overlap with these.
const WALL_TIME = ["rollout", "scoring", "policy_update", "reward_update"];

/** Returns the sections below a run's curves. */
export function facts({ run, configuration, differences, summary, failure, published, command }) {
  return [
    element("h2", {}, "Status"), list([...standing(run, summary, failure), ...ofAuthors(published)]),
    ...(summary ? [element("h2", {}, "Where the time went since the last start"), parts(summary.seconds)] : []),
    element("h2", {}, "Reproduce this run"),
    element("p", {}, element("code", {}, command), " ", copying(command)),
    element("h2", {}, "Settings that are not the default"), settings(differences),
    element("details", {}, element("summary", {}, "The whole configuration"), element("pre", {}, configuration)),
  ];
}

/** Returns a button that copies a text, if the browser allows copying: over HTTP only for pages from this machine. */
function copying(text) {
  if (!navigator.clipboard) return "";
  const copy = button("Copy", () => navigator.clipboard.writeText(text).then(
    () => { copy.textContent = "Copied"; }, () => { copy.textContent = "The browser refuses to copy"; },
  ));
  return copy;
}

/** Returns the comparison below the curves of several runs. */
export function compared(all) {
  const known = (details) => details.differences ?? [];
  const keys = [...new Set(all.flatMap((details) => known(details).map(({ key }) => key)))].sort();
  const value = (details, key) => known(details).find((other) => other.key === key)?.value ?? "";
  const differing = keys.filter((key) => new Set(all.map((details) => value(details, key))).size > 1);
  const row = (name, cells) => element("tr", {},
    element("td", { class: "text" }, element("code", {}, name)), cells.map((cell) => element("td", { class: "text wrap" }, cell)));
  const facts = [["task", "task"], ["method", "method"], ["preset", "preset"], ["seed", "seed"], ["steps", "steps_wanted"]];
  const rows = [
    ...facts.map(([name, key]) => row(name, all.map(({ run }) => String(run[key])))),
    ...differing.map((key) => row(key, all.map((details) => value(details, key)))),
    row("evaluation", all.map(({ run }) => percent(run.evaluated_success_rate))),
    row("build", all.map(({ summary }) => (summary ? builds(summary) : "-"))),
    row("policy SHA-256", all.map(({ summary }) => summary?.policy_sha256.slice(0, 16) ?? "-")),
  ];
  const head = ["", ...all.map(({ run }) => run.id)].map((name) => element("th", { class: "text", scope: "col" }, name));
  return [
    element("h2", {}, "Differences"),
    element("p", { class: "soft" }, "An empty cell means the default of the run's task, preset and method; of a task of your own, settings are not compared."),
    element("div", { class: "scroll" }, element("table", {},
      element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows))),
  ];
}

function ofAuthors(published) {
  return published === null ? [] : [["success, published by the authors", `${percent(published.rate)}, ${published.source}`]];
}

/** Returns the row of the reward model's hash; none for a method that learns no reward. */
function ofRewardModel({ reward_model_sha256: hash }) {
  return hash === undefined ? [] : [["reward model SHA-256", element("code", {}, hash)]];
}

function standing(run, summary, failure) {
  const rows = [
    ["state", element("span", { class: `state ${run.state}` }, run.state)],
    ...(failure ? [["failed because", failure]] : []),
    ["task, method, preset, seed", `${run.task}, ${run.method}, ${run.preset}, ${run.seed}`],
    ["begun", date(run.begun)],
    ...(run.steps_wanted > 0 ? [["environment steps", `${count(run.environment_steps)} of ${count(run.steps_wanted)}`]] : []),
    ["success, last 100 training episodes", percent(run.success_rate)],
    ["time", duration(run.wall_s)],
  ];
  if (!summary) return rows;
  const { evaluation, time_to_success: times } = summary;
  return [
    ...rows,
    evaluated(evaluation),
    ["speed", `${count(summary.steps_per_s)} steps/s`],
    ...times.map((time) => [`${percent(time.success_rate)} for good`, `${duration(time.wall_s)}, ${count(time.environment_steps)} steps`]),
    ["policy SHA-256", element("code", {}, summary.policy_sha256)],
    ...ofRewardModel(summary),
    ["build", builds(summary)],
  ];
}

function evaluated({ success_rate: rate, mean_return: mean, episodes }) {
  // The task does not tell success.
  if (rate === null) return ["mean return, evaluation", `${short(mean)} over ${count(episodes)} episodes`];
  return ["success, evaluation", `${percent(rate)} of ${count(episodes)} episodes`];
}

function builds(summary) {
  const all = summary.builds.map((build) => Object.values(build).filter((part) => typeof part === "string").join(" "));
  return all.join("; ") || "unknown";
}

function list(rows) {
  const pairs = rows.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]);
  return element("dl", { class: "facts" }, pairs);
}

function settings(differences) {
  if (differences === null) return element("p", {}, "Not known: the task is not one of Goalward's.");
  if (differences.length === 0) return element("p", {}, "None: all settings are the defaults of its task, preset and method.");
  const rows = differences.map(({ key, value, default: usual }) => element("tr", {},
    element("td", { class: "text" }, element("code", {}, key)),
    element("td", { class: "text wrap" }, value), element("td", { class: "text wrap" }, usual)));
  const head = ["setting", "value", "default"].map((name) => element("th", { class: "text", scope: "col" }, name));
  return element("div", { class: "scroll" }, element("table", {},
    element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows)));
}

function parts(seconds) {
  const found = WALL_TIME.map((name) => [name, seconds[name]]);
  const total = found.reduce((sum, [, value]) => sum + value, 0);
  const bars = found.map(([name, value], index) => {
    const bar = element("span", { title: `${name}: ${duration(value)}` });
    bar.style.flexGrow = value / total;
    bar.style.background = `var(--c${index % 8})`;
    return bar;
  });
  const names = found.map(([name, value], index) => {
    const mark = element("span");
    mark.style.background = `var(--c${index % 8})`;
    return element("li", {}, mark, `${name.replaceAll("_", " ")} ${duration(value)}`);
  });
  return element("div", {}, element("div", { class: "parts" }, bars), element("ul", { class: "legend" }, names));
}
