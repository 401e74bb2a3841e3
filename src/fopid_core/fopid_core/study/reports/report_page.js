"use strict";
const figures = JSON.parse(document.getElementById("figures").textContent);
const plots = Array.from(document.querySelectorAll(".plot"));
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const NARROW = 520;
const PRINTED = { signals: { width: 680, height: 480 }, other: { width: 325, height: 270 } };  // as in the style

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function look(printed) {
  return printed
    ? { ink: "#000000", quiet: "#4a535c", rule: "#d5d9dd", paper: "#ffffff" }
    : { ink: colour("--ink"), quiet: colour("--quiet"), rule: colour("--rule"), paper: colour("--paper") };
}

function axis(own, style) {
  return {
    gridcolor: style.rule, linecolor: style.quiet, zerolinecolor: style.rule, showline: true, ticks: "outside",
    tickcolor: style.quiet, automargin: true, ...own, title: { standoff: 8, ...own.title },
  };
}

function annotation(own, narrow) {
  const text = narrow && own.name === "phase" ? own.text.split(" ")[0] : own.text;
  return { ...own, text, font: { size: narrow ? 11 : 12, ...own.font } };
}

function layout(own, style, kind, width) {
  const narrow = width < NARROW;
  const styled = { ...own };
  for (const key of Object.keys(own).filter((name) => /^[xy]axis\d*$/.test(name))) {
    styled[key] = axis(own[key], style);
  }
  styled.annotations = (own.annotations || []).map((item) => annotation(item, narrow));
  return {
    showlegend: false, ...styled,
    font: { family: getComputedStyle(document.body).fontFamily, size: narrow ? 12 : 13, color: style.ink },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: narrow ? 46 : 60, r: 12, t: kind === "signals" ? 46 : 30, b: 44 },
    hoverlabel: { bgcolor: style.paper, bordercolor: style.rule, font: { color: style.ink } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: style.quiet, activecolor: style.ink },
    dragmode: "zoom", width: undefined, autosize: true,
  };
}

function config(width) {
  return {
    responsive: true, displaylogo: false, displayModeBar: width < NARROW ? false : "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]], toImageButtonOptions: { format: "svg" },
  };
}

function draw(plot, printed) {
  const kind = plot.classList.contains("signals") ? "signals" : "other";
  const width = printed ? PRINTED[kind].width : plot.clientWidth;
  const figure = figures[plot.dataset.figure];
  const styled = layout(figure.layout, look(printed), kind, width);
  if (printed) Object.assign(styled, PRINTED[kind], { autosize: false });
  return Plotly.react(plot, figure.data, styled, config(width));
}

function drawAll(printed) {
  return Promise.all(plots.map((plot) => draw(plot, printed)));
}

let wide = window.innerWidth >= NARROW;
window.addEventListener("resize", () => {
  if (wide !== (window.innerWidth >= NARROW)) {
    wide = !wide;
    drawAll(false);
  }
});
dark.addEventListener("change", () => drawAll(false));
window.addEventListener("beforeprint", () => drawAll(true));
window.addEventListener("afterprint", () => drawAll(false));
drawAll(false).then(() => document.documentElement.setAttribute("data-drawn", "true"));
