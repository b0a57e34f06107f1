"use strict";
// The page is a terminal: it posts lines ("1.2 3.4", u, k, s) and shows the state in the answer.
const at = (id) => document.getElementById(id);
let state = { version: null };

function made(tag, text, ...inside) {
  const element = document.createElement(tag);
  element.append(...(text === "" ? [] : [text]), ...inside);
  return element;
}

function cells(place, columns, hints) {
  place.replaceChildren(...columns.map((column, i) => {
    const input = document.createElement("input");
    Object.assign(input, { name: column, inputMode: "decimal", placeholder: hints[i] ?? "" });
    return made("label", column, input);
  }));
}

const inputs = () => [...document.querySelectorAll("#entry input")];

function chart({ forecast, course, goal }) {
  const logs = [...forecast, ...course, goal].filter(Boolean).map(Math.log10);
  const low = Math.floor(Math.min(...logs)), high = Math.ceil(Math.max(...logs));
  const most = Math.max(forecast.length, course.length, 2);
  const x = (n) => 34 + (280 * (n - 1)) / (most - 1), y = (v) => 8 + (140 * (high - Math.log10(v))) / (high - low || 1);
  const draw = (tag, attributes, text = "") => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    Object.entries(attributes).forEach(([name, value]) => element.setAttribute(name, value));
    element.textContent = text;
    return element;
  };
  const places = (values) => values.flatMap((v, i) => (v ? [[x(i + 1).toFixed(1), y(v).toFixed(1)]] : []));
  const decades = Array.from({ length: high - low + 1 }, (_, i) => 10 ** (low + i));
  at("chart").replaceChildren(
    ...decades.flatMap((v) => [
      draw("path", { class: "axis", d: `M34,${y(v)}H314` }),
      draw("text", { x: 30, y: y(v) + 3, "text-anchor": "end" }, String(Number(v.toPrecision(1)))),
    ]),
    draw("text", { x: 34, y: 164 }, "1"), draw("text", { x: 314, y: 164, "text-anchor": "end" }, String(most)),
    ...(goal ? [draw("path", { class: "goal", d: `M34,${y(goal)}H314` })] : []),
    draw("path", { d: `M${places(forecast).join("L") || "0,0"}` }),
    ...places(course).map(([cx, cy]) => draw("circle", { cx, cy, r: 2.5 })),
  );
}

function show(news) {
  const moved = news.version !== state.version, turned = news.row !== state.row;
  state = news;
  if (!moved) return;
  at("count").textContent = `${news.count} measured`;
  at("next").textContent = `pose ${news.row} of ${news.rows}${news.named && ` (${news.named})`}: drive to`;
  at("points").replaceChildren(...news.set_points.map(([name, unit, value]) =>
    made("div", "", made("dt", `${name} [${unit}]`), made("dd", value))));
  at("pose").textContent = news.pose.map(([name, unit, value]) => `${name} ${value} ${unit}`).join(", ");
  cells(at("observed"), news.observed, []);
  cells(at("readings"), news.columns.filter((column) => !news.observed.includes(column)), news.set_points.map((point) => point[2]));
  at("read").hidden = news.columns.length === news.observed.length;
  at("entry").hidden = news.off;
  at("off").hidden = !news.off;
  at("off").firstElementChild.textContent = news.off ? news.verdict : "";
  at("verdict").textContent = news.off ? "" : news.verdict;
  at("undo").disabled = news.count === 0;
  at("progress").replaceChildren(...news.progress.map((line) => made("li", line)));
  at("doubtful").hidden = !news.doubtful;
  at("doubtful").textContent = `undo row ${news.doubtful}`;
  at("doubtful").dataset.line = `u ${news.doubtful}`;
  at("progress").classList.toggle("enough", news.enough);
  at("parameters").replaceChildren(...news.parameters.map((row, i) =>
    made("tr", "", ...row.map((cell) => made(i ? "td" : "th", cell)))));
  chart(news);
  if (turned) at("machine").src = `/picture?row=${news.row - 1}`;
  (news.off ? at("off").querySelector("button") : inputs()[0])?.focus();
}

async function post(line) {
  const body = line === undefined ? undefined : JSON.stringify({ line, row: state.row - 1, version: state.version });
  try {
    const answer = await fetch("/state", body ? { method: "POST", body } : {});
    const news = await answer.json();
    show(news);
    if (body) at("trouble").textContent = news.trouble;
  } catch {
    at("trouble").textContent = "pincal does not answer; start it again: what was recorded is on the disk";
  }
}

at("entry").addEventListener("submit", (event) => {
  event.preventDefault();
  const filled = inputs().filter((input) => input.value.trim()), empty = inputs().find((input) => !input.value.trim());
  if (empty && state.observed.includes(empty.name) && document.activeElement.value?.trim()) return empty.focus();
  post(JSON.stringify(Object.fromEntries(filled.map((input) => [input.name, input.value.trim().replace(",", ".")]))));
});
at("entry").addEventListener("paste", (event) => {
  const numbers = event.clipboardData.getData("text").trim().split(/\s*[;\t\s]\s*/);
  if (numbers.length < 2) return;
  event.preventDefault();
  numbers.forEach((number, i) => { if (inputs()[i]) inputs()[i].value = number; });
});
document.addEventListener("click", ({ target }) => { if (target.dataset?.line) post(target.dataset.line); });
document.addEventListener("keydown", ({ key }) => { if (state.off && (key === "u" || key === "k")) post(key); });
setInterval(() => { if (!document.hidden) post(); }, 2000);
post();
