// Zoom and pan of a plot by mouse, fingers and keys. Dragging zooms (the plot itself does it), with Shift it pans.

const IN = 0.6, OUT = 1 / IN, STEP = 0.25;

const KEYS = {
  "+": ({ zoom }) => zoom(IN), "=": ({ zoom }) => zoom(IN), "-": ({ zoom }) => zoom(OUT),
  ArrowLeft: ({ shift }) => shift(-STEP), ArrowRight: ({ shift }) => shift(STEP),
  Home: ({ live }) => live(), Escape: ({ live }) => live(),
};

function wheel(chart, { zoom }) {
  chart.over.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== chart.root.parentElement) return;  // the page scrolls
    event.preventDefault();
    zoom(event.deltaY < 0 ? IN : OUT, chart.posToVal(event.offsetX, "x"));
  }, { passive: false });
}

function pan(chart, { shift }) {
  let last = null;
  chart.over.addEventListener("mousedown", (event) => {
    if (!event.shiftKey) return;
    event.stopImmediatePropagation();
    last = event.clientX;
  }, { capture: true });
  const move = (event) => {
    if (last === null) return;
    shift((last - event.clientX) / chart.over.clientWidth);
    last = event.clientX;
  };
  const end = () => { last = null; };
  chart.over.addEventListener("mousemove", move);
  chart.over.addEventListener("mouseup", end);
  chart.over.addEventListener("mouseleave", end);
}

// Two fingers zoom, and move what is between them.
function pinch(chart, { zoom, shift }) {
  let before = null;
  const of = (touches) => {
    const [left, right] = [touches[0].clientX, touches[1].clientX].sort((a, b) => a - b);
    return { middle: (left + right) / 2, width: Math.max(right - left, 10) };
  };
  chart.over.addEventListener("touchmove", (event) => {
    if (event.touches.length !== 2) return;
    event.preventDefault();
    const now = of(event.touches);
    if (before) {
      shift((before.middle - now.middle) / chart.over.clientWidth);
      zoom(before.width / now.width, chart.posToVal(now.middle - chart.over.getBoundingClientRect().left, "x"));
    }
    before = now;
  }, { passive: false });
  chart.over.addEventListener("touchend", () => { before = null; });
}

function keys(chart, moves, focusable) {
  const place = chart.root.parentElement;
  place.tabIndex = focusable ? 0 : -1;
  place.onkeydown = (event) => {
    if (event.target !== place || !(event.key in KEYS) || event.altKey || event.metaKey || event.ctrlKey) return;
    event.preventDefault();
    KEYS[event.key](moves);
  };
}

// One of several plots that move together is enough for the keyboard to stop at.
export function navigate(chart, moves, focusable = true) {
  wheel(chart, moves);
  pan(chart, moves);
  pinch(chart, moves);
  keys(chart, moves, focusable);
  chart.over.addEventListener("dblclick", moves.live);
}
