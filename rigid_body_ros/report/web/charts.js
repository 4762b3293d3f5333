'use strict';
// Draw charts in SVG. Each panel shows curves, and can be zoomed and read with a cursor. Panels
// with the same x axis are linked.

const page = JSON.parse(document.getElementById('data').textContent);

const DASHES = ['', '7 3', '8 3 2 3', '2 3'];
const MARGIN = {left: 62, right: 10, top: 8, bottom: 34};
const HEIGHT = 210;
const PREFIXES = {0: '', '-3': 'm', '-6': 'µ', '-9': 'n', '-12': 'p', '-15': 'f', '-18': 'a'};

const markAt = (x, y) => `M ${(x - 3).toFixed(1)} ${(y - 3).toFixed(1)} l 6 6 m -6 0 l 6 -6`;

// The panels that share an x axis. They are zoomed together and have a common cursor.
class Group {
  constructor(box) {
    this.box = box;
    this.panels = [];
    this.cursor = null;
    this.listeners = [];
  }

  add(panel) {
    this.panels.push(panel);
    const [low, high] = panel.extent();
    this.whole = this.whole ? [Math.min(this.whole[0], low), Math.max(this.whole[1], high)]
      : [low, high];
    this.range = this.whole.slice();
  }

  show(low, high) {
    const least = 1e-9 * Math.max(Math.abs(this.whole[1]), this.whole[1] - this.whole[0]);
    if (high - low < least) return;
    this.range = [Math.max(low, this.whole[0]), Math.min(high, this.whole[1])];
    this.panels.forEach((panel) => panel.draw());
  }

  zoom(factor) {
    const [low, high] = this.range, span = (high - low) * factor;
    const inside = this.cursor !== null && this.cursor >= low && this.cursor <= high;
    const middle = inside ? this.cursor : (low + high) / 2;
    const first = Math.max(this.whole[0], Math.min(middle - span / 2, this.whole[1] - span));
    this.show(first, first + span);
  }

  moveCursor(value, from) {
    this.cursor = Math.max(this.whole[0], Math.min(value, this.whole[1]));
    this.panels.forEach((panel) => panel.drawCursor());
    this.listeners.forEach((listener) => listener !== from && listener(this.cursor));
  }
}

class Panel {
  constructor(data, group) {
    this.data = data;
    this.group = group;
    this.logX = data.kind === 'loglog' || data.kind === 'logx';
    this.logY = data.kind === 'loglog' || data.kind === 'log';
    this.tall = data.kind === 'loglog';
    this.height = this.tall ? 2 * HEIGHT : HEIGHT;
    this.lines = this.bands = 0;
    this.isDense = data.curves.some((curves) => curves.style === 'limits');
    // Several bands leave the dashes of their lines visible.
    this.isNoisy = data.kind === 'log' || data.curves.some(({style, names}) =>
      style !== 'line' && !(style === 'band' && names.length > 1));
    this.series = data.curves.flatMap((curves) => this.read(curves));
    this.unit = this.withPrefix();
    const box = html('div', group.box);
    box.className = 'panel';
    html('h3', box, data.label + (this.unit ? ` (${this.unit})` : ''));
    this.svg = element('svg', {class: this.tall ? 'plot tall' : 'plot', role: 'img', 'aria-label':
      `${data.label} over ${data.xLabel}: ${this.named().map((one) => one.name).join(', ')}`}, box);
    this.legend(box);
    if (data.texts.length) {
      this.said = html('p', box, 'Point at a marker to read it.');
      this.said.className = 'said';
      this.said.setAttribute('aria-live', 'polite');
    }
    group.add(this);
    this.listen();
  }

  read(curves) {
    const x = unpacked(curves.x, Float64Array);
    const low = unpacked(curves.low, Float32Array);
    const high = curves.high === null ? low : unpacked(curves.high, Float32Array);
    return curves.names.map((name, k) => {
      const part = [k * x.length, (k + 1) * x.length], offset = curves.offsets[k];
      const values = (source) => Float64Array.from(source.subarray(...part), (v) => v + offset);
      const lower = values(low);
      return {name, x, low: lower, high: high === low ? lower : values(high), step: curves.step,
        style: curves.style, isAlone: curves.names.length === 1, gap: curves.gap ?? Infinity,
        ...this.look(curves, k)};
    });
  }

  // Return the colour and the dashes of a curve. Noisy curves are not dashed. Broad lines, marks
  // and limits have the colours of the lines that they belong to.
  look(curves, k) {
    if (curves.style === 'line') {
      const number = this.lines++;
      return {colour: `c${number % 6}`, dashes: this.isNoisy ? '' : DASHES[number % 4]};
    }
    if (curves.style === 'band' && curves.names.length === 1)
      return {colour: ['c5', 'c0'][this.bands++ % 2], dashes: ''};
    if (curves.style === 'front') return {colour: 'c5', dashes: ''};
    const isLimit = curves.style === 'limits';
    return {colour: isLimit && curves.names.length === 1 ? 'c3' : `c${k % 6}`,
      dashes: isLimit ? '5 4' : ''};
  }

  named() { return this.series.filter((one) => one.name); }

  // Return the unit, with a prefix if all numbers are small, as in mrad/s.
  withPrefix() {
    this.scale = 1;
    const [lowest, highest] = this.extremes(), largest = Math.max(-lowest, highest);
    const span = Math.min(highest - lowest || largest, largest);
    // The resolution of the values that are shown at the cursor.
    this.finest = 10 ** (Math.floor(Math.log10(span || 1)) - 3);
    if (!this.data.unit || this.logY || this.data.kind === 'angle' || !(largest > 0))
      return this.data.unit;
    const power = Math.max(-18, Math.min(0, 3 * Math.floor(Math.log10(largest) / 3)));
    this.scale = 10 ** power;
    return PREFIXES[power] + this.data.unit;
  }

  extremes() {
    let low = Infinity, high = -Infinity;
    for (const one of this.series.filter(({style}) => style !== 'marks')) {
      for (let i = 0; i < one.x.length; i++) {
        low = Math.min(low, one.low[i]);
        high = Math.max(high, one.high[i]);
      }
    }
    return [low, high];
  }

  legend(box) {
    const list = html('ul', box);
    list.className = 'legend';
    this.named().forEach((one) => {
      const item = html('li', list);
      const line = element('svg', {viewBox: '0 0 30 10', 'aria-hidden': 'true'}, item);
      if (one.style === 'marks') element('path', {d: markAt(15, 5), class: 'curve c6'}, line);
      else element('path', {d: 'M 0 5 L 30 5', class: `curve swatch ${one.style} ${one.style ===
        'limits' ? 'c3' : one.colour}`, 'stroke-dasharray': one.dashes}, line);
      html('span', item, `${one.name} `);
      if (one.style !== 'marks' && (!['limits', 'band'].includes(one.style) || one.isAlone))
        one.reading = html('output', item);
    });
  }

  extent() {
    let low = Infinity, high = -Infinity;
    for (const one of this.series) {
      for (const x of this.logX ? one.x : [one.x[0], one.x[one.x.length - 1]]) {
        low = Math.min(low, x);
        high = Math.max(high, x);
      }
    }
    for (const x of Object.values(this.data.lines)) {
      low = Math.min(low, x);
      high = Math.max(high, x);
    }
    if (!(low < Infinity)) return [0, 1];
    if (this.logX) return this.tall ? [low / 2, high * 2] : [low, high];
    return high > low ? [low, high] : [low, low + 1e-9];
  }

  toX(value) {
    const [low, high] = this.group.range, f = this.logX ? Math.log10 : (v) => v;
    return MARGIN.left + this.width * (f(value) - f(low)) / (f(high) - f(low));
  }

  fromX(pixel) {
    const [low, high] = this.group.range, part = (pixel - MARGIN.left) / this.width;
    return this.logX ? low * (high / low) ** part : low + part * (high - low);
  }

  toY(value) {
    const f = this.logY ? (v) => Math.log10(Math.max(v, 1e-300)) : (v) => v;
    const [low, high] = this.limits.map(f);
    const part = Math.max(-10, Math.min(10, (f(value) - low) / (high - low)));
    return this.height - MARGIN.bottom - (this.height - MARGIN.top - MARGIN.bottom) * part;
  }

  visible(one) {
    const [low, high] = this.group.range;
    if (this.logX) return [0, one.x.length];
    return [indexAt(one.x, low), Math.min(one.x.length, indexAt(one.x, high) + 2)];
  }

  findLimits() {
    let low = Infinity, high = -Infinity;
    for (const one of this.series.filter(({style}) => style !== 'marks')) {
      const [first, stop] = this.visible(one);
      for (let i = first; i < stop; i++) {
        if (this.logY && one.high[i] <= 0) continue;
        low = Math.min(low, this.logY && one.low[i] <= 0 ? one.high[i] : one.low[i]);
        high = Math.max(high, one.high[i]);
      }
    }
    if (!(low < Infinity)) [low, high] = this.logY ? [0.1, 1] : [-1, 1];
    if (this.logY) {  // do not extend the axis down to where an error happens to cross zero
      low = Math.max(low, this.logX ? 0 : high * 1e-6);
      this.limits = [low / 2, high * 2];
    } else {
      const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
      this.limits = [low - room, high + room];
    }
  }

  draw() {
    const full = this.svg.clientWidth || 600;
    this.width = full - MARGIN.left - MARGIN.right;
    this.svg.setAttribute('viewBox', `0 0 ${full} ${this.height}`);
    this.svg.replaceChildren();
    this.findLimits();
    this.drawAxes();
    const frame = element('svg', {x: MARGIN.left, y: 0, width: this.width, height:
      this.height - MARGIN.bottom, viewBox: `${MARGIN.left} 0 ${this.width} ${this.height - MARGIN.bottom}`},
    this.svg);
    for (const style of ['band', 'front', 'broad', 'line', 'limits', 'marks'])
      for (const one of this.series.filter((each) => each.style === style))
        element('path', {d: this.shape(one),
          class: `curve ${style} ${one.colour}${this.isDense ? ' dense' : ''}`,
          'stroke-dasharray': one.dashes}, frame);
    this.drawLines(frame);
    if (this.data.texts.length) this.drawPoints(frame);
    this.chosen = element('rect', {class: 'chosen', y: 0, height: this.height, width: 0}, frame);
    this.line = element('line', {class: 'cursor', y1: 0, y2: this.height}, frame);
    this.drawCursor();
  }

  shape(one) {
    if (one.style === 'marks') return this.marks(one);
    if (one.style === 'band') return this.band(one);
    if (one.style !== 'limits') return this.path(one);
    return `${this.path({...one, high: one.low})} ${this.path({...one, low: one.high})}`;
  }

  band(one) {
    const [first, stop] = this.visible(one);
    const edge = (values) => Array.from(values.slice(first, stop)).flatMap((value, k) =>
      [one.x[first + k], ...(one.step ? [one.x[Math.min(first + k + 1, stop - 1)]] : [])].map(
        (x) => `${this.toX(x).toFixed(1)} ${this.toY(value).toFixed(1)}`));
    return `M ${[...edge(one.low), ...edge(one.high).reverse()].join(' L ')} Z`;
  }

  // Draw single points. Points outside the range of the y axis are drawn at its edge.
  marks(one) {
    const [first, stop] = this.visible(one), parts = [], bottom = this.height - MARGIN.bottom;
    for (let i = first; i < stop; i++) {
      for (const value of new Set([one.low[i], one.high[i]]))
        parts.push(markAt(this.toX(one.x[i]),
          Math.max(MARGIN.top, Math.min(this.toY(value), bottom - 4))));
    }
    return parts.join(' ');
  }

  // Return the path of a curve. If a pixel column contains several samples, the path has only two
  // points there: the minimum and the maximum.
  path(one) {
    const [first, stop] = this.visible(one), parts = [];
    const jump = this.data.kind === 'angle' ? Math.PI : Infinity;
    let pen = 'M', before = NaN, beforeY = 0;
    const point = (x, y) => {
      if (one.step && pen === 'L') parts.push('L', x.toFixed(1), beforeY.toFixed(1));
      parts.push(pen, x.toFixed(1), y.toFixed(1));
      [pen, beforeY] = ['L', y];
    };
    for (let i = first; i < stop;) {
      const x = this.toX(one.x[i]);
      let low = one.low[i], high = one.high[i], last = one.low[i], k = i + 1;
      if (Math.abs(last - before) > jump || one.x[i] - one.x[i - 1] > one.gap) pen = 'M';
      while (k < stop && stop - first > 2 * this.width && this.toX(one.x[k]) < x + 1
             && Math.abs(one.low[k] - last) <= jump && one.x[k] - one.x[k - 1] <= one.gap) {
        low = Math.min(low, one.low[k]);
        high = Math.max(high, one.high[k]);
        last = one.low[k++];
      }
      const rising = !(Math.abs(before - high) < Math.abs(before - low));
      point(x, this.toY(rising ? low : high));
      if (high > low) point(x, this.toY(rising ? high : low));
      before = last;
      i = k;
    }
    if (one.step && stop === one.x.length && parts.length)
      parts.push('L', this.toX(this.group.whole[1]).toFixed(1), beforeY.toFixed(1));
    return parts.join(' ');
  }

  // Draw vertical lines with their names. The names alternate between the top and the bottom of
  // the chart.
  drawLines(frame) {
    Object.entries(this.data.lines).forEach(([name, value], k) => {
      const x = this.toX(value), side = x < MARGIN.left + 16 ? 12 : -4;
      const [y, anchor] = k % 2 ? [this.height - MARGIN.bottom - 4, 'start'] : [MARGIN.top, 'end'];
      element('line', {x1: x, x2: x, y1: 0, y2: this.height, class: 'c6'}, frame);
      element('text', {class: 'mark', transform: `translate(${x + side} ${y}) rotate(-90)`,
        'text-anchor': anchor}, frame).textContent = name;
    });
  }

  drawPoints(frame) {
    this.data.texts.forEach((texts, k) => texts.forEach((said, i) => {
      const one = this.series[k], x = one.x[i], text = `${one.name}: ${said}`;
      const point = element('circle', {class: `point ${one.colour}`, cx: this.toX(x),
        cy: this.toY(one.low[i]), r: 5, tabindex: 0, role: 'img', 'aria-label': text}, frame);
      for (const event of ['focus', 'pointerenter'])
        point.addEventListener(event, () => { this.said.textContent = text; });
    }));
  }

  ticks(limits, count, logarithmic) {
    if (logarithmic) {
      const [low, high] = limits.map(Math.log10), found = [];
      const step = Math.max(1, Math.ceil((high - low) / count));
      for (let power = Math.ceil(low); power <= high; power += step)
        found.push([10 ** power, `1e${power}`.replace('-', '−')]);
      if (found.length > 1) return found;
      return limits.map((v) => [v, String(Number(v.toPrecision(2))).replace('-', '−')]);
    }
    const step = niceStep(limits[1] - limits[0], count), found = [];
    for (let n = Math.ceil(limits[0] / step); n * step <= limits[1]; n++)
      found.push([n * step, written(n * step, step)]);
    return found;
  }

  drawAxes() {
    const bottom = this.height - MARGIN.bottom, right = MARGIN.left + this.width;
    for (const [value, text] of this.yTicks()) {
      const y = this.toY(value);
      element('line', {x1: MARGIN.left, x2: right, y1: y, y2: y, class: 'grid'}, this.svg);
      element('text', {x: MARGIN.left - 6, y: y + 4, 'text-anchor': 'end'}, this.svg)
        .textContent = text;
    }
    for (const [value, text] of this.ticks(this.group.range, this.width / 80, this.logX)) {
      const x = this.toX(value);
      element('line', {x1: x, x2: x, y1: MARGIN.top, y2: bottom, class: 'grid'}, this.svg);
      const room = Math.max(x, MARGIN.left + 4);
      element('text', {x: Math.min(room, right - 12), y: bottom + 14, 'text-anchor': 'middle'},
        this.svg).textContent = text;
    }
    element('text', {x: MARGIN.left + this.width / 2, y: this.height - 4, 'text-anchor': 'middle'},
      this.svg).textContent = this.data.xLabel;
  }

  yTicks() {
    if (this.data.kind === 'angle' && this.limits[1] - this.limits[0] > 2) {
      const names = ['−π', '−π/2', '0', 'π/2', 'π', '3π/2', '2π'];
      return names.map((name, k) => [(k - 2) * Math.PI / 2, name])
        .filter(([value]) => value >= this.limits[0] && value <= this.limits[1]);
    }
    const limits = this.limits.map((value) => value / this.scale);
    return this.ticks(limits, 5, this.logY).map(([value, text]) => [value * this.scale, text]);
  }

  drawCursor() {
    const value = this.group.cursor;
    if (value === null || !this.line) return;
    const x = this.toX(value);
    this.line.setAttribute('x1', x);
    this.line.setAttribute('x2', x);
    if (this.logX) return;
    this.named().filter((one) => one.reading && one.x.length).forEach((one) => {
      const i = indexAt(one.x, value), shown = (v) => (this.logY ? v.toPrecision(4)
        : written(v / this.scale, this.finest / this.scale));
      one.reading.textContent = one.low[i] === one.high[i] ? shown(this.drawn(one, i, value))
        : `${shown(one.low[i])} to ${shown(one.high[i])}`;
    });
  }

  // Return the height of the drawn curve at a value between x[i] and x[i + 1].
  drawn(one, i, value) {
    const before = one.low[i], change = one.low[i + 1] - before;
    const jump = this.data.kind === 'angle' ? Math.PI : Infinity;
    if (one.step || !(Math.abs(change) <= jump) || value <= one.x[i]) return before;
    return before + change * (value - one.x[i]) / (one.x[i + 1] - one.x[i]);
  }

  listen() {
    let from = null;
    const at = (event) => {
      const box = this.svg.getBoundingClientRect();
      return Math.max(MARGIN.left, Math.min(MARGIN.left + this.width, event.clientX - box.left));
    };
    this.svg.addEventListener('pointerdown', (event) => {
      from = at(event);
      this.svg.setPointerCapture(event.pointerId);
    });
    this.svg.addEventListener('pointermove', (event) => {
      if (from === null) return;
      const to = at(event);
      this.chosen.setAttribute('x', Math.min(from, to));
      this.chosen.setAttribute('width', Math.abs(to - from));
    });
    this.svg.addEventListener('pointerup', (event) => {
      if (from === null) return;
      const [low, high] = [from, at(event)].sort((a, b) => a - b);
      from = null;
      this.chosen.setAttribute('width', 0);
      if (high - low < 5) { if (!this.logX) this.group.moveCursor(this.fromX(high)); }
      else this.group.show(this.fromX(low), this.fromX(high));
    });
    this.svg.addEventListener('pointercancel', () => {
      from = null;
      this.chosen.setAttribute('width', 0);
    });
    this.svg.addEventListener('dblclick', () => this.group.show(...this.group.whole));
  }
}

const groups = {};

function addGroup(hasCursor) {
  const parent = document.getElementById('charts'), box = html('p', parent);
  const group = new Group(html('div', parent));
  group.box.className = 'group';
  const all = (['Zoom in', 'Zoom out', 'Whole']).map((text) => {
    const button = html('button', box, text);
    button.type = 'button';
    box.append(' ');
    return button;
  });
  all[0].addEventListener('click', () => group.zoom(0.5));
  all[1].addEventListener('click', () => group.zoom(2));
  all[2].addEventListener('click', () => group.show(...group.whole));
  html('span', box, 'Drag across a chart to zoom, double-click for the whole' +
    (hasCursor ? ', click to set the cursor.' : '.'));
  return group;
}

for (const data of page.panels) {
  const name = data.kind === 'loglog' ? data.label : data.xLabel;
  groups[name] ||= addGroup(!data.kind.startsWith('log') || data.kind === 'log');
  new Panel(data, groups[name]);
}

function drawCharts() {
  Object.values(groups).forEach((group) => group.panels.forEach((panel) => panel.draw()));
}

drawCharts();
let drawnWidth = innerWidth;
addEventListener('resize', () => {
  if (innerWidth !== drawnWidth) drawCharts();
  drawnWidth = innerWidth;
});
for (const copy of document.querySelectorAll('.copy')) {
  copy.addEventListener('click', () => {
    getSelection().selectAllChildren(copy.previousElementSibling);
    copy.textContent = document.execCommand('copy') ? 'Copied' : 'Press Ctrl+C';
  });
}
