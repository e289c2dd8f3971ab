"use strict";
// Curves that can be zoomed: drag to zoom, double-click to see all again. The SVG below stays for print.
(() => {
  const ink = (name) => () => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const axis = (more) => ({ stroke: ink("--faint"), grid: { stroke: ink("--line"), width: 1 }, ticks: { stroke: ink("--line") }, ...more });
  const power = (value) => {
    if (value === null) return "";
    const text = value.toPrecision(1);
    return value >= 0.01 && value < 1000 ? String(+text) : value.toExponential(0).replace("e+", "e").replace("-", "−");
  };
  const logSplits = (_, splits) => splits.map((v) => (v !== null && /^1(\.|e|$)/.test(v.toExponential()) ? power(v) : ""));
  const plots = [];

  const clipped = (u, work) => {
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    work(u.ctx);
    u.ctx.restore();
  };
  const shade = (data) => (u) => data.window && clipped(u, (ctx) => {
    const [from, to] = data.window.map((r) => u.valToPos(r, "x", true));
    ctx.globalAlpha = 0.35;
    ctx.fillStyle = ink("--line")();
    ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
  });
  const asIs = (u, low, high) => [low, high];

  function bars(data) {
    return (u) => clipped(u, (ctx) => {
      ctx.beginPath();
      ctx.strokeStyle = ink("--point")();
      ctx.globalAlpha = 0.5;
      data.r.forEach((r, i) => {
        if (data.lo[i] === null || data.hi[i] === null || r < u.scales.x.min || r > u.scales.x.max) return;
        const x = u.valToPos(r, "x", true);
        ctx.moveTo(x, u.valToPos(data.lo[i], "y", true));
        ctx.lineTo(x, u.valToPos(data.hi[i], "y", true));
      });
      ctx.stroke();
    });
  }

  function draw(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const box = figure.querySelector(".live");
    const has = (name) => data[name].some((value) => value !== null);
    if (!has("rd") || !has("model")) return; // the printed figure stays where nothing was fitted
    figure.classList.add("has-live");
    const pair = [];
    let busy = false;
    const together = (u, key) => {
      if (key !== "x" || busy) return;
      busy = true;
      pair.forEach((other) => other !== u && other.setScale("x", { min: u.scales.x.min, max: u.scales.x.max }));
      busy = false;
    };
    const both = { cursor: { drag: { x: true, y: false } }, legend: { live: true } };
    const dot = (colour) => ({ stroke: ink(colour), paths: () => null, points: { show: true, size: 5, fill: ink(colour) } });
    const through = (colour, dash) => ({ stroke: ink(colour), width: 1.5, dash, spanGaps: true, points: { show: false } });
    const digits = (u, v) => (v === null || v === undefined ? "–" : v.toPrecision(3));
    const width = () => Math.max(260, figure.clientWidth);
    const lines = [["rd", "measured", dot("--point")], ["model", "model", through("--model")],
      ["dipole", "dipole", through("--dipole", [6, 4])], ["mc", "Monte Carlo", through("--mc", [2, 3])]].filter(([name]) => has(name));
    const curve = new uPlot({
      ...both, width: width(), height: 330, scales: { x: { time: false, distr: 3, range: asIs }, y: { distr: 3, range: (u, low, high) => (low > 0 && high >= low ? [low / 1.2, high * 1.2] : [0.001, 1]) } },
      axes: [axis({ values: logSplits }), axis({ values: logSplits, label: "R_d, 1/mm²", size: 62 })],
      series: [{ label: "r, mm", value: digits }, ...lines.map(([, label, look]) => ({ label, ...look, value: digits }))],
      hooks: { drawClear: [shade(data)], draw: [bars(data)], setScale: [together] },
    }, [data.r, ...lines.map(([name]) => data[name])], box);
    const shown = data.z.map((z) => (z === null ? null : Math.max(-8, Math.min(8, z))));
    const residual = has("z") && new uPlot({
      ...both, width: width(), height: 170, scales: { x: { time: false, distr: 3, range: asIs }, y: { range: (u, lo, hi) => { const far = Math.max(3, ...[-lo, hi].filter(Number.isFinite)); return [-far, far]; } } },
      axes: [axis({ values: logSplits, label: "distance from the beam, mm" }), axis({ label: "residual, sd", size: 62, space: 18 })],
      series: [{ label: "r, mm", value: digits }, { label: "(measured − model)/sd", ...dot("--point"), value: digits }],
      hooks: { drawClear: [shade(data)], setScale: [together] },
    }, [data.r, shown], box);
    pair.push(...[curve, residual].filter(Boolean));
    plots.push(...pair);
    new ResizeObserver(() => pair.forEach((u) => figure.clientWidth && u.width !== width() && u.setSize({ width: width(), height: u.height }))).observe(figure);
  }

  document.querySelectorAll("figure.panel").forEach(draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.forEach((u) => u.redraw(false, true)));
})();
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((each) => { each.open = true; }));
