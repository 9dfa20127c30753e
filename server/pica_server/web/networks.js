/**
 * Runs networks of TensorFlow Lite, as far as MediaPipe's face landmarker needs it. Their tensors
 * lie in a memory of WebAssembly, where functions that are assembled here do most of the work.
 */

/** @typedef {{shape: number[], size: number, at: number, data: Float32Array, stored: Float32Array |
 * null}} Tensor Where it lies; `stored` is what it holds for good. */
/** @typedef {(...numbers: number[]) => void} Work @typedef {{multiply: Work, addTimes: Work,
 * rectify: Work}} Program */
/** @typedef {{inputs: Tensor[], out: Tensor, option: (index: number) => number,
 * more: (shape: number[], stored?: Float32Array) => Tensor}} Step `more` makes a tensor. */
/** @typedef {(step: Step) => (program: Program) => void} Operation */

/** A product is made in pieces of so many columns and rows, and writes beyond its end. */
const [COLUMNS, ROWS] = [8, 4];
const [FLOAT16, DEQUANTIZE, PAGE] = [1, 6, 65_536];

/** A table of a FlatBuffer, whose fields have numbers; those that are left out are 0, or empty. */
class Table {
  /** @param {DataView} view @param {number} at */
  constructor(view, at) {
    this.view = view;
    this.at = at;
  }

  /** Where a field lies. @param {number} index */
  field(index) {
    const { at, view } = this;
    const [fields, entry] = [at - view.getInt32(at, true), 4 + 2 * index];
    const offset = entry < view.getUint16(fields, true) ? view.getUint16(fields + entry, true) : 0;
    return offset && at + offset;
  }

  /** @param {number} index */
  byte(index) {
    return this.field(index) && this.view.getInt8(this.field(index));
  }

  /** @param {number} index */
  int(index) {
    return this.field(index) && this.view.getInt32(this.field(index), true);
  }

  /** Where a list begins, and how long it is. @param {number} index */
  list(index) {
    const at = this.field(index) && this.field(index) + this.int(index);
    return { at: at + 4, length: at && this.view.getUint32(at, true) };
  }

  /** @param {number} index */
  ints(index) {
    const { at, length } = this.list(index);
    return Array.from({ length }, (_, k) => this.view.getInt32(at + 4 * k, true));
  }

  /** @param {number} index */
  tables(index) {
    const { at } = this.list(index);
    return this.ints(index).map((offset, k) => new Table(this.view, at + 4 * k + offset));
  }
}

/** A whole number as WebAssembly stores it. @param {number} value @returns {number[]} */
const leb = (value) => (value >= -64 && value < 64 ? [value & 127]
  : [(value & 127) | 128, ...leb(value >> 7)]);
/** @param {number} local */
const get = (local) => [0x20, local];
/** @param {number} local @param {number[]} code */
const set = (local, code) => [...code, 0x21, local];
/** @param {number} number */
const int = (number) => [0x41, ...leb(number)];
/** @type {(left: number[], right: number[]) => number[]} */
const add = (left, right) => [...left, ...right, 0x6a];
/** @type {(left: number[], right: number[]) => number[]} */
const times = (left, right) => [...left, ...right, 0x6c];
/** @type {(body: number[], again: number[]) => number[]} */
const loop = (body, again) => [0x03, 0x40, ...body, ...again, 0x0d, 0, 0x0b];
/** Four numbers. @param {number[]} at @param {number} skipped How many after it. */
const load = (at, skipped = 0) => [...at, 0xfd, 0, 2, 4 * skipped];
const [STORE, PLUS, TIMES, LEAST, MOST] = [[11, 2, 0], [0xe4, 1], [0xe6, 1], [0xe8, 1], [0xe9, 1]]
  .map((code) => [0xfd, ...code]);

/** `out[row, c] = bias[c] + Σ a[row, k] weights[k, c]`, from the last columns to the first: what is
 * written beyond a row is overwritten. */
function product() {
  const [a, weights, bias, out, rows, inner, columns] = [0, 1, 2, 3, 4, 5, 6];
  const [stride, block, row, weight, to, from] = [7, 8, 9, 10, 11, 12];
  const [sums, pair, value] = [16, 24, 26];
  const lines = [0, 1, 2, 3].map((line) => ({ line, local: from + line }));
  const parts = lines.flatMap(({ line }) =>
    [0, 1].map((half) => ({ line, half, local: sums + 2 * line + half })));
  const multiply = [
    ...set(pair, load(get(weight))), ...set(pair + 1, load(get(weight), 4)),
    ...lines.flatMap(({ line, local }) => [
      ...set(value, [...get(local), 0xfd, 9, 2, 0]), // one number four times
      ...parts.filter((part) => part.line === line).flatMap((part) => set(part.local,
        [...get(part.local), ...get(value), ...get(pair + part.half), ...TIMES, ...PLUS])),
      ...set(local, add(get(local), int(4))),
    ]),
    ...set(weight, add(get(weight), int(4 * COLUMNS))),
  ];
  const someRows = [
    ...parts.flatMap(({ half, local }) =>
      set(local, load(add(get(bias), times(get(block), int(4))), 4 * half))),
    ...lines.flatMap(({ line, local }) =>
      set(local, add(get(row), times(get(stride), int(line))))),
    ...set(weight, add(get(weights), times(get(stride), get(block)))),
    ...loop(multiply, [...get(from), ...add(get(row), get(stride)), 0x49]),
    ...parts.flatMap(({ line, half, local }) => [
      ...add(add(get(to), times(get(columns), int(4 * line))), int(16 * half)), ...get(local),
      ...STORE]),
    ...set(to, add(get(to), times(get(columns), int(4 * ROWS)))),
    ...set(row, add(get(row), times(get(stride), int(ROWS)))),
  ];
  const someColumns = [
    ...set(row, get(a)), ...set(to, add(get(out), times(get(block), int(4)))),
    ...loop(someRows, [...get(row), ...add(get(a), times(get(rows), get(stride))), 0x49]),
    ...set(block, add(get(block), int(-COLUMNS))),
  ];
  return [
    ...set(stride, times(get(inner), int(4))),
    ...set(block, [...add(get(columns), int(-1)), ...int(-COLUMNS), 0x71]),
    ...loop(someColumns, [...get(block), ...int(0), 0x4e]),
  ];
}

/** Pixel by pixel, four channels at once: what `value` makes of `out`, `a` and a channel's factor.
 * @param {(out: number[], a: number[], factor: number[]) => number[]} value */
function perPixel(value) {
  const [a, factors, out, count, bytes, step, channel] = [0, 1, 2, 3, 4, 5, 7];
  const [to, ...from] = [out, out, a, factors].map((local) => add(get(local), get(channel)));
  const [before, other, factor] = from.map((at) => load(at));
  const some = [...to, ...value(before, other, factor), ...STORE,
    ...set(channel, add(get(channel), int(16)))];
  return loop([
    ...set(channel, int(0)), ...loop(some, [...get(channel), ...get(bytes), 0x49]),
    ...set(out, add(get(out), get(bytes))), ...set(a, add(get(a), get(step))),
    ...set(count, add(get(count), int(-1))),
  ], get(count));
}

/** @param {WebAssembly.Memory} memory @returns {Program} */
function assemble(memory) {
  const zero = get(16); // a local that is never set
  /** @type {Record<keyof Program, number[]>} */
  const bodies = {
    multiply: product(),
    addTimes: perPixel((out, a, factor) => [...out, ...a, ...factor, ...TIMES, ...PLUS]),
    rectify: perPixel((_, a, slope) =>
      [...a, ...zero, ...MOST, ...a, ...zero, ...LEAST, ...slope, ...TIMES, ...PLUS]),
  };
  /** @param {number[]} content */
  const sized = (content) => [...leb(content.length), ...content];
  const names = Object.keys(bodies).map((name) => sized([...new TextEncoder().encode(name)]));
  /** @type {[number, number[]][]} */
  const sections = [
    [1, [1, 0x60, 7, ...Array(7).fill(0x7f), 0]], // functions of seven whole numbers
    [2, [1, 1, 0x6d, 1, 0x6d, 2, 0, 1]], [3, [3, 0, 0, 0]], // the memory m.m; three of them
    [7, [3, ...names.flatMap((name, k) => [...name, 0, k])]],
    // With 9 locals for whole numbers and 11 for vectors.
    [10, [3, ...Object.values(bodies).flatMap((body) =>
      sized([2, 9, 0x7f, 11, 0x7b, ...body, 0x0b]))]],
  ];
  const bytes = [0, 0x61, 0x73, 0x6d, 1, 0, 0, 0,
    ...sections.flatMap(([id, content]) => [id, ...sized(content)])];
  const module = new WebAssembly.Module(Uint8Array.from(bytes));
  return /** @type {any} */ (new WebAssembly.Instance(module, { m: { m: memory } }).exports);
}

/** @param {number[]} shape */
const sizeOf = (shape) => shape.reduce((all, side) => all * side, 1);

/** Which number of a tensor stands for each of a larger one, whose axes may be in another order.
 * @param {number[]} from @param {number[]} to */
function spread(from, to, order = [...to.keys()]) {
  const shape = [...Array(to.length - from.length).fill(1), ...from];
  const steps = order.map((axis) => (shape[axis] === 1 ? 0 : sizeOf(shape.slice(axis + 1))));
  return Int32Array.from({ length: sizeOf(to) }, (_, at) => to.reduceRight((place, side, axis) => {
    const found = place + (at % side) * steps[axis];
    at = Math.floor(at / side);
    return found;
  }, 0));
}

/** The runs of pixels that each place of a window meets: the place, the first pixel of the output
 * and of the input, how many. @param {Step} step */
function runsOf({ inputs: [a, weights], out, option }) {
  const [[, height, width], [, tall, wide], [, rows, columns]] =
    [a, weights, out].map(({ shape }) => shape);
  const [isValid, stride] = [option(0), option(1)];
  /** @type {(size: number, count: number, window: number) => number} */
  const margin = (size, count, window) =>
    (isValid ? 0 : Math.max((count - 1) * stride + window - size, 0) >> 1);
  const [above, left] = [margin(height, rows, tall), margin(width, columns, wide)];
  const found = [];
  for (let y = 0; y < rows; y++) {
    for (let k = 0; k < tall * wide; k++) {
      const [from, shift] = [y * stride - above + Math.floor(k / wide), (k % wide) - left];
      const first = Math.max(Math.ceil(-shift / stride), 0);
      const count = Math.min(Math.floor((width - 1 - shift) / stride) + 1, columns) - first;
      if (from < 0 || from >= height) continue;
      found.push([k, y * columns + first, from * width + first * stride + shift, count]);
    }
  }
  return found;
}

/** @type {Operation} */
function convolve(step) {
  const { inputs: [a, weights, bias], out, option, more } = step;
  const [columns, tall, wide, channels] = weights.shape;
  const [inner, rows] = [weights.size / columns, out.size / columns];
  const matrix = new Float32Array(inner * Math.ceil(columns / COLUMNS) * COLUMNS);
  weights.stored?.forEach((value, at) => {
    const [column, k] = [Math.floor(at / inner), at % inner];
    matrix[(column - (column % COLUMNS)) * inner + k * COLUMNS + (column % COLUMNS)] = value;
  });
  const kept = more([matrix.length], matrix);
  const isPlain = tall * wide === 1;
  const windows = isPlain ? a : more([rows, inner]);
  const runs = isPlain ? [] : runsOf(step);
  return ({ multiply }) => {
    for (const [k, pixel, start, count] of runs) {
      for (let x = 0; x < count; x++) {
        const to = (pixel + x) * inner + k * channels;
        const from = (start + x * option(1)) * channels;
        for (let c = 0; c < channels; c++) windows.data[to + c] = a.data[from + c];
      }
    }
    multiply(windows.at, kept.at, bias.at, out.at, rows, inner, columns);
    if (option(3)) out.data.forEach((value, at) => (out.data[at] = Math.max(value, 0)));
  };
}

/** Each channel by itself. @type {Operation} */
function convolveChannels(step) {
  const { inputs: [a, weights, bias], out, option, more } = step;
  const channels = out.shape[3];
  const [runs, bytes, line] = [runsOf(step), 4 * channels, 4 * Math.ceil(channels / 4)];
  const factors = new Float32Array((weights.size / channels) * line);
  weights.stored?.forEach((value, at) =>
    (factors[Math.floor(at / channels) * line + (at % channels)] = value));
  const kept = more([factors.length], factors);
  return ({ addTimes }) => {
    out.data.set(bias.data);
    for (let at = channels; at < out.size; at *= 2) out.data.copyWithin(at, 0, at);
    for (const [k, to, from, count] of runs) {
      addTimes(a.at + from * bytes, kept.at + 4 * k * line, out.at + to * bytes, count, bytes,
        bytes * option(1));
    }
  };
}

/** Below zero, times a slope of the channel. @type {Operation} */
function rectify({ inputs: [a, slopes], out, more }) {
  const kept = slopes ?? more([4], new Float32Array(4));
  const bytes = 4 * kept.size;
  return (program) => program.rectify(a.at, kept.at, out.at, a.size / kept.size, bytes, bytes);
}

/** The largest of each two by two. @type {Operation} */
function pool({ inputs: [a], out }) {
  const [, rows, columns, channels] = out.shape;
  const line = 2 * columns * channels;
  return () => {
    for (let pixel = 0, at = 0; pixel < rows * columns; pixel++) {
      const from = Math.floor(pixel / columns) * 2 * line + (pixel % columns) * 2 * channels;
      for (let c = from; c < from + channels; c++) {
        out.data[at++] = Math.max(a.data[c], a.data[c + channels], a.data[c + line],
          a.data[c + line + channels]);
      }
    }
  };
}

/** More channels, of zeros. @type {Operation} */
const pad = ({ inputs: [a], out }) => () => {
  const [few, many] = [a, out].map(({ shape }) => shape[3]);
  out.data.fill(0);
  for (let at = 0, to = 0; at < a.size; at += few, to += many) {
    out.data.set(a.data.subarray(at, at + few), to);
  }
};
/** One after the other, along the first axis that has any length, as many as there is room for.
 * @type {Operation} */
const copy = ({ inputs, out }) => () => void inputs.reduce((at, { data }) => {
  out.data.set(data.subarray(0, out.size - at), at);
  return Math.min(at + data.length, out.size);
}, 0);
/** @type {Operation} */
function transpose({ inputs: [a, axes], out }) {
  const places = spread(a.shape, out.shape, Array.from(axes.stored ?? []));
  return () => places.forEach((place, at) => (out.data[at] = a.data[place]));
}
/** Sums over axes; means, if they are divided. @param {boolean} isMean @returns {Operation} */
const reduce = (isMean) => ({ inputs: [a], out }) => {
  const places = spread(out.shape, a.shape);
  const scale = isMean ? out.size / a.size : 1;
  return () => {
    out.data.fill(0);
    places.forEach((place, at) => (out.data[place] += a.data[at] * scale));
  };
};
/** Each number by itself. @param {(a: number, b: number) => number} f @returns {Operation} */
const each = (f) => ({ inputs: [a, b = a], out }) => {
  const [first, second] = [a, b].map(({ shape }) => spread(shape, out.shape));
  return () => first.forEach((place, at) => (out.data[at] = f(a.data[place], b.data[second[at]])));
};
/** @type {Operation} */
function plus(step) {
  const { inputs: [a, b], out, more } = step;
  if (a.size !== b.size) return each((x, y) => x + y)(step);
  const ones = more([4], new Float32Array(4).fill(1));
  return ({ addTimes }) => {
    out.data.set(a.data);
    addTimes(b.at, ones.at, out.at, a.size / 4, 16, 16);
  };
}

/** By their codes in the file. @type {Record<number, Operation>} */
const OPERATIONS = {
  0: plus, 2: copy, 3: convolve, 4: convolveChannels, 14: each((a) => 1 / (1 + Math.exp(-a))),
  17: pool, 18: each((a, b) => a * b), 19: rectify, 22: copy, 34: pad, 39: transpose,
  40: reduce(true), 41: each((a, b) => a - b), 42: each((a, b) => a / b), 45: copy, 54: rectify,
  59: each((a) => -a), 74: reduce(false), 75: each(Math.sqrt), 76: each((a) => 1 / Math.sqrt(a)),
  99: each((a, b) => (a - b) ** 2),
};

/** What runs a network: its first input's numbers in, those of each output out.
 * @param {DataView} view Of its file. @returns {(values: ArrayLike<number>) => Float32Array[]} */
export function openNetwork(view) {
  const model = new Table(view, view.getUint32(0, true));
  const codes = model.tables(1).map((code) => Math.max(code.byte(0), code.int(3)));
  const [[graph], buffers] = [model.tables(2), model.tables(4)];
  const steps = graph.tables(3).map((step) => ({
    code: codes[step.int(0)], given: step.ints(1), made: step.ints(2)[0],
    options: step.field(4) && new Table(view, step.field(4) + step.int(4)),
  }));
  /** @type {Tensor[]} */
  const tensors = [];
  /** @type {(shape: number[], stored?: Float32Array | null) => Tensor} */
  function more(shape, stored = null) {
    tensors.push({ shape, size: sizeOf(shape), at: 0, data: new Float32Array(), stored });
    return tensors[tensors.length - 1];
  }
  for (const table of graph.tables(0)) {
    const { at, length } = buffers[table.int(2)].list(0);
    const bytes = view.buffer.slice(view.byteOffset + at, view.byteOffset + at + length);
    const type = table.byte(1);
    const values = new (type === FLOAT16 ? Float16Array : type ? Int32Array : Float32Array)(
      /** @type {ArrayBuffer} */ (bytes));
    more(table.ints(0), length ? Float32Array.from(values) : null);
  }
  let end = 16;
  /** @param {Tensor} tensor */
  function place(tensor) {
    if (tensor.at) return;
    tensor.at = end;
    const beyond = (ROWS - 1) * (tensor.shape.at(-1) ?? 1) + COLUMNS;
    end += Math.ceil((tensor.size + beyond) / 4) * 16;
  }
  const works = steps.flatMap(({ code, given, made, options }) => {
    const [out, known] = [tensors[made], tensors.length];
    const inputs = given.map((index) => tensors[index]);
    if (code === DEQUANTIZE) {
      out.stored = inputs[0].stored;
      return [];
    }
    inputs.forEach(place);
    const work = OPERATIONS[code]({ inputs, out, more,
      option: (index) => (options ? options.byte(index) : 0) });
    [out, ...tensors.slice(known)].forEach(place);
    return [work];
  });
  const memory = new WebAssembly.Memory({ initial: Math.ceil(end / PAGE) + 1 });
  for (const tensor of tensors.filter(({ at }) => at)) {
    tensor.data = new Float32Array(memory.buffer, tensor.at, tensor.size);
    if (tensor.stored) tensor.data.set(tensor.stored);
    tensor.stored = null;
  }
  const program = assemble(memory);
  const [input] = graph.ints(1).map((index) => tensors[index]);
  const outputs = graph.ints(2).map((index) => tensors[index]);
  return (values) => {
    input.data.set(values);
    works.forEach((work) => work(program));
    return outputs.map(({ data }) => data.slice());
  };
}
