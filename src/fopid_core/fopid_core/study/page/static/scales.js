// The range a plot shows and the numbers along it: any magnitude, no noise blown up, no spike that hides the rest.

const LEVEL = 1e-5;  // of what is shown: a signal that moves by less is level
const ROUNDING = 1e-9;  // of the largest that the plot has ever shown: what is below is rounding
const LEAST = 1e-12;  // no plot is finer than this
const LARGEST = 1e300;
const ROOM = 0.08;
const LOOKS = 1000;  // instants at which a signal is looked at to tell spikes
const RARE = 0.01;  // of the time, at each end
const FAR = 5;  // times the range of the rest, as in the report

// Least and greatest of the numbers in columns, rows from `first` to before `last`.
export function extremes(columns, first, last) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) {
    for (let i = first; i < last; i++) {
      const value = column[i];
      if (value === null) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return low <= high ? [Math.max(low, -LARGEST), Math.min(high, LARGEST)] : null;
}

// The range without rare values far from all others; null when there are none. By time, since rows are dense in places.
export function spikeFree(times, columns, first, last) {
  const values = [], from = times[first], step = (times[last - 1] - from) / LOOKS;
  if (!(step > 0)) return null;
  for (const column of columns) {
    let row = first;
    for (let look = 0; look <= LOOKS; look++) {
      while (row + 1 < last && times[row + 1] <= from + look * step) row++;
      if (column[row] !== null) values.push(column[row]);
    }
  }
  const whole = extremes(columns, first, last);
  if (whole === null || values.length < 100) return null;
  values.sort((a, b) => a - b);
  const low = values[Math.floor(RARE * values.length)], high = values[Math.ceil((1 - RARE) * values.length) - 1];
  if (high === low || whole[1] - whole[0] <= FAR * (high - low)) return null;
  const room = 0.5 * (high - low);
  return [Math.max(low - room, whole[0]), Math.min(high + room, whole[1])];
}

// With room above and below, and wide enough that neither noise of rounding nor a level signal fills it.
export function roomy([low, high], greatest) {
  const size = Math.max(Math.abs(low), Math.abs(high));
  const least = Math.max(LEVEL * size, ROUNDING * greatest, LEAST);
  if (high - low < least) {
    const middle = low / 2 + high / 2, half = Math.max(0.1 * size, least) / 2 || 0.5;
    return [middle - half, middle + half];
  }
  const room = ROOM * (high - low);
  return [low - room, high + room];
}

// Round numbers in a range, about so many.
export function ticks([low, high], about) {
  const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= raw) * power, found = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) found.push(i * step);
  return { found, step };
}

// A number with as many digits as tell neighbours apart.
export function label(value, step) {
  if (Math.abs(value) < step / 2) return "0";
  const size = Math.floor(Math.log10(Math.abs(value))), finest = Math.floor(Math.log10(step) + 1e-9);
  if (size >= 6 || size < -4) return value.toExponential(Math.min(Math.max(size - finest, 0), 8)).replace("e+", "e");
  return value.toFixed(Math.min(Math.max(-finest, 0), 12));
}
