// The interactive field: adds up and scales the tables that the engine wrote (field_tables.js). No physics is here.
"use strict";

const FIELD = (() => {
  const data = window.MODALTOUCH_FIELD;
  if (!data) return null;
  const bytes = Uint8Array.from(atob(data.history), (each) => each.charCodeAt(0));
  const codes = new Int16Array(bytes.buffer);
  const nModes = data.labels.length, nTimes = data.time_ms.length, nPlaces = data.places_mm.length;

  // Value of a row of a table at a place of the beam, straight between its points.
  const at = (row, place) => {
    const step = data.places_mm[1] - data.places_mm[0];
    const along = Math.min(Math.max((place - data.places_mm[0]) / step, 0), nPlaces - 1);
    const left = Math.min(Math.floor(along), nPlaces - 2);
    return row[left] + (along - left) * (row[left + 1] - row[left]);
  };
  const sum = (values, rows, place) => rows.reduce((total, row, k) => total + values[k] * at(row, place), 0);

  // Modal velocities that make the level at the focus; null where the chosen modes cannot.
  const modal = (level, focus, chosen) => {
    const wanted = data.coefficients[data.foci_mm.indexOf(focus)].map((each, k) => (chosen[k] ? each : 0));
    const reached = sum(wanted, data.shapes, focus);
    return Math.abs(reached) < 0.02 ? null : wanted.map((each) => (each * level) / reached);
  };
  // What becomes of them under two typical fingers.
  const touched = (velocity, left, right) => {
    const rows = data.touched[`${left} ${right}`];
    return velocity.map((_, j) => velocity.reduce((total, each, k) => total + each * rows[k][j], 0));
  };
  const field = (velocity) => data.places_mm.map((place) => sum(velocity, data.shapes, place));
  // Largest speed at a place during the burst.
  const peak = (velocity, place) => {
    const course = new Float64Array(nTimes);
    for (let j = 0; j < nModes; j++) {
      const shape = at(data.shapes[j], place);
      for (let k = 0; k < nModes; k++) {
        const factor = (velocity[k] * shape * data.history_scale[k][j]) / 32767;
        if (factor === 0) continue;
        const start = (k * nModes + j) * nTimes;
        for (let t = 0; t < nTimes; t++) course[t] += factor * codes[start + t];
      }
    }
    return course.reduce((largest, each) => Math.max(largest, Math.abs(each)), 0);
  };
  return { data, modal, touched, field, peak, speed: (velocity, place) => sum(velocity, data.shapes, place) };
})();

window.addEventListener("DOMContentLoaded", () => {
  const root = document.getElementById("field");
  if (!root || !FIELD) return;
  const { data } = FIELD;
  const state = { level: 200, focus: 0, left: -40, right: 0, heavy: false, chosen: data.labels.map((each) => data.selected.includes(each)) };
  // On a phone the drawing is narrower, not smaller.
  const WIDTH = window.matchMedia("(max-width: 40em)").matches ? 400 : 720, HEIGHT = 360, EDGE = 46, LOW = 62;
  const x = (place) => EDGE + ((place + 50) / 100) * (WIDTH - 2 * EDGE);
  const place = (px) => ((px - EDGE) / (WIDTH - 2 * EDGE)) * 100 - 50;
  const y = (speed) => HEIGHT - LOW - ((speed + 120) / 380) * (HEIGHT - LOW - 16);
  const zoneOf = (mm) => Object.keys(data.zones_mm).find((each) => mm >= data.zones_mm[each][0] && mm < data.zones_mm[each][1]) || "–";

  const range = (name, label, low, high, step, unit) =>
    `<label>${label} <output id="field-${name}-value"></output> ${unit}<input type="range" id="field-${name}" min="${low}" max="${high}" step="${step}" value="${state[name]}"></label>`;
  const zones = Object.entries(data.zones_mm).map(([name, [from, to]], k) =>
    `<rect class="zone${k % 2 ? " odd" : ""}" x="${x(from)}" y="10" width="${x(to) - x(from)}" height="${HEIGHT - LOW - 4}"/><text x="${x((from + to) / 2)}" y="${HEIGHT - LOW + 18}">${name}</text>`);
  const lines = [-100, 0, 100, 200].map((speed) =>
    `<line class="grid" x1="${EDGE}" x2="${WIDTH - EDGE}" y1="${y(speed)}" y2="${y(speed)}"/><text class="tick" x="${EDGE - 6}" y="${y(speed) + 4}">${speed}</text>`);
  root.innerHTML = `
    <svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-labelledby="field-said">${zones.join("")}${lines.join("")}
      <text class="axis" x="${EDGE}" y="8">mm/s</text>
      <path class="untouched"/><path class="now"/>
      <rect class="beam" x="${x(-50)}" y="${HEIGHT - 34}" width="${x(50) - x(-50)}" height="8" rx="2"/>
      <g class="handle" data-name="focus"><line y1="14" y2="${HEIGHT - 34}"/><path d="M-10,14 L10,14 L0,28 Z"/></g>
      <g class="handle finger" data-name="left"><circle cy="${HEIGHT - 30}" r="13"/><text y="${HEIGHT - 25}">L</text></g>
      <g class="handle finger" data-name="right"><circle cy="${HEIGHT - 30}" r="13"/><text y="${HEIGHT - 25}">R</text></g>
    </svg>
    <p id="field-said" aria-live="polite"></p>
    <table><thead><tr><th>finger</th><th>zone</th><th>at the focusing instant</th><th>at most, untouched</th></tr></thead>
      <tbody><tr id="field-row-left"></tr><tr id="field-row-right"></tr></tbody></table>
    <div class="controls">
      ${range("focus", "Focus", -45, 45, 1, "mm")}${range("level", "Level", 20, 200, 10, "mm/s")}
      ${range("left", "Left finger", -45, 45, 1, "mm")}${range("right", "Right finger", -45, 45, 1, "mm")}
    </div>
    <fieldset><legend>Modes</legend>${data.labels.map((label, k) =>
      `<label><input type="checkbox" data-mode="${k}"${state.chosen[k] ? " checked" : ""}> ${label} <small>${(data.frequencies_Hz[k] / 1000).toFixed(1)} kHz</small></label>`).join("")}</fieldset>
    <label><input type="checkbox" id="field-heavy"> Let the two fingers load the beam (typical fingertips, placed every 10 mm)</label>
    <p><button type="button" id="field-reset">As in the paper</button></p>`;

  const find = (name) => root.querySelector(name);
  const path = (values) => values.map((speed, k) => `${k ? "L" : "M"}${x(data.places_mm[k]).toFixed(1)},${y(speed).toFixed(1)}`).join("");

  const settle = () => {
    for (const name of ["focus", "left", "right"]) state[name] = Math.min(Math.max(Math.round(state[name]), -45), 45);
    if (state.heavy) {
      for (const name of ["left", "right"]) state[name] = Math.min(Math.max(10 * Math.round(state[name] / 10), -40), 40);
    }
    if (state.left >= state.right) {
      const step = state.heavy ? 10 : 1;
      if (state.moved === "right") state.left = state.right - step; else state.right = state.left + step;
      const [low, high] = state.heavy ? [-40, 40] : [-45, 45];
      if (state.left < low) [state.left, state.right] = [low, low + step];
      if (state.right > high) [state.left, state.right] = [high - step, high];
    }
  };

  const show = () => {
    settle();
    const velocity = FIELD.modal(state.level, state.focus, state.chosen);
    for (const name of ["focus", "level", "left", "right"]) {
      find(`#field-${name}`).value = state[name];
      find(`#field-${name}-value`).textContent = state[name];
    }
    for (const handle of root.querySelectorAll(".handle")) handle.setAttribute("transform", `translate(${x(state[handle.dataset.name])},0)`);
    const said = find("#field-said");
    if (!velocity) {
      for (const name of ["now", "untouched"]) find(`.${name}`).setAttribute("d", "");
      for (const name of ["left", "right"]) find(`#field-row-${name}`).innerHTML = `<td>${name}</td><td>${zoneOf(state[name])}</td><td>–</td><td>–</td>`;
      said.textContent = "These modes cannot move the focus: each has a node there, or none is selected.";
      root.dataset.reached = "";
      return;
    }
    const now = state.heavy ? FIELD.touched(velocity, state.left, state.right) : velocity;
    find(".untouched").setAttribute("d", state.heavy ? path(FIELD.field(velocity)) : "");
    find(".now").setAttribute("d", path(FIELD.field(now)));
    const reached = FIELD.speed(now, state.focus);
    said.textContent = state.heavy
      ? `The drive is designed for ${state.level} mm/s; under these fingers the focus reaches ${reached.toFixed(0)} mm/s.`
      : `The focus at ${state.focus} mm reaches ${reached.toFixed(0)} mm/s.`;
    root.dataset.reached = reached.toFixed(3);
    for (const name of ["left", "right"]) {
      find(`#field-row-${name}`).innerHTML = `<td>${name}</td><td>${zoneOf(state[name])}</td>` +
        `<td>${FIELD.speed(now, state[name]).toFixed(1)} mm/s</td><td>${FIELD.peak(velocity, state[name]).toFixed(1)} mm/s</td>`;
    }
  };

  for (const name of ["focus", "level", "left", "right"]) {
    const slider = find(`#field-${name}`), handle = find(`[data-name=${name}]`);
    for (const [kind, is] of [["focus", true], ["blur", false]]) slider.addEventListener(kind, () => handle?.classList.toggle("active", is));
    slider.addEventListener("input", (event) => { state[name] = Number(event.target.value); state.moved = name; show(); });
  }
  root.querySelectorAll("[data-mode]").forEach((box) => box.addEventListener("change", () => { state.chosen[box.dataset.mode] = box.checked; show(); }));
  find("#field-heavy").addEventListener("change", (event) => { state.heavy = event.target.checked; show(); });
  find("#field-reset").addEventListener("click", () => {
    Object.assign(state, { level: 200, focus: 0, left: -40, right: 0, heavy: false, chosen: data.labels.map((each) => data.selected.includes(each)) });
    find("#field-heavy").checked = false;
    root.querySelectorAll("[data-mode]").forEach((box) => { box.checked = state.chosen[box.dataset.mode]; });
    show();
  });

  const svg = find("svg");
  let dragged = null;
  const follow = (event) => {
    if (!dragged) return;
    const box = svg.getBoundingClientRect();
    state[dragged] = place(((event.clientX - box.left) / box.width) * WIDTH);
    state.moved = dragged;
    show();
  };
  root.querySelectorAll(".handle").forEach((handle) => handle.addEventListener("pointerdown", (event) => {
    dragged = handle.dataset.name;
    svg.setPointerCapture(event.pointerId);
    event.preventDefault();
  }));
  svg.addEventListener("pointermove", follow);
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { dragged = null; });
  show();
});
