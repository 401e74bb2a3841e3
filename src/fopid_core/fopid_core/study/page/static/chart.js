// How every chart looks: colours, axes, numbers.

// As in the report: each stands out on white and on black alike.
export const GREY = "#86909b", BLUE = "#2f7fc1", GREEN = "#2b9a66", VIOLET = "#8e6bbf", RED = "#d1582a";

export function digits(value) {
  return value === null || value === undefined ? "–" : Number(value.toPrecision(5)).toString();
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export function axis(more) {
  return {
    stroke: colour("--quiet"), font: `12px ${getComputedStyle(document.body).fontFamily}`,
    grid: { stroke: colour("--rule"), width: 1 }, ticks: { stroke: colour("--rule"), width: 1, size: 5 }, ...more,
  };
}

// Some room above and below; a level signal gets a scale, too.
export function range(plot, low, high) {
  if (low === null || high === null) return [0, 1];
  const room = (high - low) * 0.08 || Math.abs(high) * 0.1 || 1;
  return [low - room, high + room];
}
