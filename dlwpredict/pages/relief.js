"use strict";
// Height maps as surfaces that can be turned: quadrilaterals painted from the back to the front, no library, no WebGL.
(() => {
  const { colours, reliefs } = JSON.parse(document.getElementById("reliefs").textContent);
  const views = [...document.querySelectorAll(".relief")];
  const sliders = Object.fromEntries(["turn", "tilt", "stretch"].map((id) => [id, document.getElementById(id)]));
  const TABLE = 256, SHADES = 24;
  const table = Array.from({ length: TABLE }, (_, k) => {
    const at = (k / (TABLE - 1)) * (colours.length - 1), low = Math.floor(at), high = Math.min(low + 1, colours.length - 1);
    return colours[low].map((value, c) => value + (at - low) * (colours[high][c] - value));
  });
  const paints = table.map((rgb) => Array.from({ length: SHADES }, (_, k) =>
    `rgb(${rgb.map((value) => Math.round(value * (0.5 + 0.5 * (k / (SHADES - 1))))).join(",")})`));

  // Heights in µm, from 16-bit levels; the last level stands for a point that was not measured.
  function heightsOf(relief) {
    const bytes = Uint8Array.from(atob(relief.levels), (letter) => letter.charCodeAt(0));
    const levels = new DataView(bytes.buffer), step = (relief.top - relief.bottom) / 65534;
    return Float64Array.from({ length: bytes.length / 2 }, (_, k) => {
      const level = levels.getUint16(2 * k, true);
      return level === 65535 ? NaN : relief.bottom + step * level;
    });
  }
  for (const relief of reliefs) relief.heights = heightsOf(relief);

  // Round number by which a relief is stretched at first: its height then is about a quarter of its width.
  function usualStretch(relief) {
    const wanted = (0.25 * Math.max(relief.width, relief.depth)) / Math.max(relief.top - relief.bottom, 1e-9);
    const steps = [...sliders.stretch.options].map((option) => Number(option.value));
    return steps.reduce((best, step) => (Math.abs(Math.log(step / wanted)) < Math.abs(Math.log(best / wanted)) ? step : best));
  }

  // Draw every point, or, while turning, no more quadrilaterals than are drawn at once.
  function draw(view, most = Infinity) {
    const canvas = view.querySelector("canvas"), relief = reliefs[view.querySelector("select").value];
    const density = Math.max(2, window.devicePixelRatio || 1), paper = canvas.getContext("2d");
    const W = canvas.clientWidth || 560, H = canvas.clientHeight || 400;
    if (canvas.width !== Math.round(W * density)) [canvas.width, canvas.height] = [Math.round(W * density), Math.round(H * density)];
    paper.setTransform(density, 0, 0, density, 0, 0);
    paper.clearRect(0, 0, W, H);
    canvas.setAttribute("aria-label", `${relief.structure}, ${relief.name}: surface seen from the side`);

    const { rows, cols, width, depth, bottom, top, low, high, heights } = relief;
    const turn = (sliders.turn.value * Math.PI) / 180, tilt = (sliders.tilt.value * Math.PI) / 180;
    const stretch = Number(sliders.stretch.value), rise = stretch * (top - bottom);
    const [ct, st, ce, se] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    const round = Math.hypot(width, depth), room = 46;
    const scale = Math.min((W - 2 * room) / round, (H - 2 * room) / (round * se + rise * ce));
    const middle = [W / 2, H / 2 + (scale * rise * ce) / 2];
    const project = (x, y, z) => [
      middle[0] + scale * (x * ct - y * st),
      middle[1] - scale * ((x * st + y * ct) * se + stretch * (z - bottom) * ce),
    ];

    // The ground, with its sides in µm along the two edges in front.
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => [(i * width) / 2, (j * depth) / 2]);
    paper.strokeStyle = "#8a939d";
    paper.lineWidth = 1;
    paper.beginPath();
    corners.forEach(([x, y], k) => paper[k ? "lineTo" : "moveTo"](...project(x, y, bottom)));
    paper.closePath();
    paper.stroke();

    const dx = width / cols, dy = depth / rows;
    const xs = new Float64Array(rows * cols), ys = new Float64Array(rows * cols);
    for (let i = 0, k = 0; i < rows; i++) for (let j = 0; j < cols; j++, k++)
      [xs[k], ys[k]] = project((j + 0.5) * dx - width / 2, depth / 2 - (i + 0.5) * dy, heights[k]);
    const light = [-0.5 * ct - 0.45 * st, 0.5 * st - 0.45 * ct, 0.74]; // from the left, in front, above; turns with the viewer
    const step = Math.ceil(Math.sqrt(Math.max((rows * cols) / most, 1)));
    const order = (n, up) => { // where quadrilaterals begin and end, from the back to the front
      const cuts = Array.from({ length: Math.ceil((n - 1) / step) + 1 }, (_, k) => Math.min(k * step, n - 1));
      const pairs = cuts.slice(1).map((end, k) => [cuts[k], end]);
      return up ? pairs : pairs.reverse();
    };
    const columns = order(cols, st < 0);
    paper.lineWidth = 0.6;
    for (const [i, below] of order(rows, ct > 0)) for (const [j, right] of columns) {
      const a = i * cols + j, b = i * cols + right, c = below * cols + j, d = below * cols + right;
      const sum = heights[a] + heights[b] + heights[c] + heights[d];
      if (Number.isNaN(sum)) continue;
      const slopeX = (stretch * (heights[b] + heights[d] - heights[a] - heights[c])) / (2 * dx * (right - j));
      const slopeY = (stretch * (heights[a] + heights[b] - heights[c] - heights[d])) / (2 * dy * (below - i));
      const facing = (light[2] - slopeX * light[0] - slopeY * light[1]) / Math.hypot(slopeX, slopeY, 1);
      const shade = Math.round(Math.min(Math.max(facing, 0), 1) * (SHADES - 1));
      const share = (sum / 4 - low) / (high - low);
      paper.fillStyle = paper.strokeStyle = paints[Math.round(Math.min(Math.max(share, 0), 1) * (TABLE - 1))][shade];
      paper.beginPath();
      paper.moveTo(xs[a], ys[a]);
      paper.lineTo(xs[b], ys[b]);
      paper.lineTo(xs[d], ys[d]);
      paper.lineTo(xs[c], ys[c]);
      paper.closePath();
      paper.fill();
      paper.stroke();
    }
    paper.fillStyle = "#1c2127";
    paper.font = "13px system-ui, 'DejaVu Sans', sans-serif";
    const say = (text, x, y, away) => {
      paper.textAlign = Math.abs(away) < 0.25 ? "center" : away > 0 ? "left" : "right";
      paper.fillText(text, Math.min(Math.max(x, 60), W - 60), Math.min(y, H - 6));
    };
    // Beside the middle of an edge of the ground, away from its centre.
    const label = (text, x, y, alongX) => {
      const [u, v] = project(x, y, bottom), [p, q] = alongX ? [ct, -st * se] : [-st, -ct * se];
      const outward = [q, -p], away = outward[0] * (u - middle[0]) + outward[1] * (v - middle[1]) < 0 ? -1 : 1;
      const [a, b] = outward.map((part) => (away * part) / Math.hypot(p, q));
      say(text, u + 16 * a, v + 16 * b + 5, a);
    };
    label(`x ${Number(width.toPrecision(4))} µm`, 0, (ct > 0 ? -depth : depth) / 2, true);
    label(`y ${Number(depth.toPrecision(4))} µm`, (st > 0 ? -width : width) / 2, 0, false);
  }

  let waiting = false, settling = 0;
  const tell = () => {
    for (const id of ["turn", "tilt"]) document.getElementById(`${id}-value`).textContent = `${sliders[id].value}°`;
  };
  function finish() {
    clearTimeout(settling);
    tell();
    views.forEach((view) => draw(view));
  }
  function redraw() {
    tell();
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      views.forEach((view) => draw(view, 2500));
      clearTimeout(settling);
      settling = setTimeout(finish, 150);
    });
  }

  const turnBy = (degrees, tilts) => {
    sliders.turn.value = ((((Number(sliders.turn.value) + degrees + 180) % 360) + 360) % 360) - 180;
    sliders.tilt.value = Number(sliders.tilt.value) + tilts;
    redraw();
  };
  const choose = (view) => {
    sliders.stretch.value = usualStretch(reliefs[view.querySelector("select").value]);
    redraw();
  };
  for (const view of views) {
    const canvas = view.querySelector("canvas");
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      last = event;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      turnBy((event.clientX - last.clientX) * 0.5, (event.clientY - last.clientY) * 0.4);
      last = event;
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (last = null));
    view.querySelector("select").addEventListener("change", () => choose(view));
  }
  for (const slider of Object.values(sliders)) slider.addEventListener("input", redraw);
  for (const change of ["resize", "beforeprint"]) window.addEventListener(change, finish);
  sliders.stretch.value = usualStretch(reliefs[views[0].querySelector("select").value]);
  finish();
})();
