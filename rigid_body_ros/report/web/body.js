'use strict';
// Draw the moving body: a box with arrows, and the inertia ellipsoid with polhode and herpolhode.

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const sum = (...all) => [0, 1, 2].map((k) => all.reduce((total, one) => total + one[k], 0));
const times = (factor, a) => a.map((value) => factor * value);
const length = (a) => Math.hypot(...a);
const applied = (rows, a) => rows.map((row) => dot(row, a));

function product(p, q) {
  return [p[3] * q[0] + q[3] * p[0] + p[1] * q[2] - p[2] * q[1],
    p[3] * q[1] + q[3] * p[1] + p[2] * q[0] - p[0] * q[2],
    p[3] * q[2] + q[3] * p[2] + p[0] * q[1] - p[1] * q[0],
    p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2]];
}

function rotated(q, v) {  // from body axes to space axes
  const twice = times(2, cross(q, v));
  return sum(v, times(q[3], twice), cross(q, twice));
}

function exponential(v) {
  const half = length(v) / 2, sinc = half > 1e-9 ? Math.sin(half) / half : 1;
  return [...times(sinc / 2, v), Math.cos(half)];
}

function logarithm(q) {
  const sign = q[3] < 0 ? -1 : 1, sine = Math.hypot(q[0], q[1], q[2]);
  return times(sign * (sine > 1e-12 ? 2 * Math.atan2(sine, sign * q[3]) / sine : 2),
    q.slice(0, 3));
}

class Motion {
  constructor(data) {
    this.times = unpacked(data.times, Float64Array);
    this.attitudes = unpacked(data.attitude, Float64Array);
    this.rates = unpacked(data.rate, Float64Array);
    this.torques = unpacked(data.torque, Float32Array);
    this.rotors = unpacked(data.rotors, Float32Array);
    this.smooth = unpacked(data.smooth, Uint8Array);
    this.inertia = data.inertia;
    this.end = this.times[this.times.length - 1];
  }

  key(i) {
    const of = (array, n) => Array.from(array.subarray(n * i, n * (i + 1)));
    return {time: this.times[i], attitude: of(this.attitudes, 4), rate: of(this.rates, 3),
      torque: of(this.torques, 3), rotors: of(this.rotors, 3)};
  }

  momentum(state) { return sum(applied(this.inertia, state.rate), state.rotors); }

  // Return the state at a time. Where interpolation would not be accurate enough, return the
  // nearest computed state.
  at(time) {
    const i = Math.min(indexAt(this.times, time), this.times.length - 1);
    const here = this.key(i);
    if (i + 1 >= this.times.length || time === here.time) return here;
    const next = this.key(i + 1), span = next.time - here.time;
    const part = (time - here.time) / span;
    if (!this.smooth[i]) return part < 0.5 ? here : next;
    const inverse = [...times(-1, here.attitude.slice(0, 3)), here.attitude[3]];
    const step = logarithm(product(inverse, next.attitude));
    const square = part * part, cube = square * part;
    const turned = sum(times(3 * square - 2 * cube, step),
      times((part - 2 * square + cube) * span, here.rate),
      times((cube - square) * span, this.vectorRate(step, next.rate)));
    return {...here, time, attitude: product(here.attitude, exponential(turned)),
      rate: sum(times(1 - part, here.rate), times(part, next.rate))};
  }

  vectorRate(vector, rate) {  // the time derivative of a rotation vector
    const angle = length(vector), half = angle / 2;
    const factor = angle < 1e-3 ? 1 / 12 : (1 - half / Math.tan(half)) / (angle * angle);
    const first = cross(vector, rate);
    return sum(rate, times(0.5, first), times(factor, cross(vector, first)));
  }
}

// Each arrow has a name, a colour number, dashes, a function that returns its vector in space
// axes, and a maximum length.
const ARROWS = [
  ['angular momentum L', 0, [], (m, s) => rotated(s.attitude, m.momentum(s)), 1.15],
  ['angular velocity ω', 1, [7, 3], (m, s) => rotated(s.attitude, s.rate), 1.05],
  ['torque τ', 2, [8, 3, 2, 3], (m, s) => rotated(s.attitude, s.torque), 0.85],
];

class View {
  constructor(name, turning, reach) {
    this.canvas = document.getElementById(name);
    this.reach = reach;
    this.turning = turning;
    this.context = this.canvas.getContext('2d');
  }

  begin() {
    const ratio = devicePixelRatio || 1, {clientWidth: w, clientHeight: h} = this.canvas;
    this.canvas.width = w * ratio;
    this.canvas.height = h * ratio;
    this.context.setTransform(ratio, 0, 0, ratio, w * ratio / 2, h * ratio / 2);
    this.size = Math.min(w, h) / (2 * this.reach);
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.context.font = '13px system-ui, sans-serif';
  }

  seen(v) {  // the components to the right, upwards and towards the eye
    const {azimuth, height} = this.turning, [s, c] = [Math.sin(azimuth), Math.cos(azimuth)];
    const across = c * v[0] + s * v[1];
    return [c * v[1] - s * v[0], Math.cos(height) * v[2] - Math.sin(height) * across,
      Math.cos(height) * across + Math.sin(height) * v[2]];
  }

  point(v) {
    const [right, up] = this.seen(v);
    return [right * this.size, -up * this.size];
  }

  path(points, colour, dashes, width) {
    const c = this.context;
    c.beginPath();
    points.forEach((point) => c.lineTo(...this.point(point)));
    c.strokeStyle = colour;
    c.setLineDash(dashes || []);
    c.lineWidth = width || 1;
    c.stroke();
    c.setLineDash([]);
  }

  dots(points, colour) {
    this.context.fillStyle = colour;
    for (const point of points) {
      const [x, y] = this.point(point);
      this.context.fillRect(x - 1, y - 1, 2, 2);
    }
  }

  arrow(tip, colour, dashes, name, width) {
    const c = this.context, [x, y] = this.point(tip), size = Math.hypot(x, y);
    this.path([[0, 0, 0], tip], colour, dashes, width || 2.5);
    c.fillStyle = colour;
    if (size > 4) {
      const [u, v] = [x / size, y / size];
      c.beginPath();
      c.moveTo(x, y);
      c.lineTo(x - 9 * u + 4 * v, y - 9 * v - 4 * u);
      c.lineTo(x - 9 * u - 4 * v, y - 9 * v + 4 * u);
      c.fill();
    }
    if (name && size > 1) c.fillText(name, x + 7, y + (y < 0 ? -5 : 13));
  }
}

class Scene {
  constructor(data) {
    this.data = data;
    this.motion = new Motion(data);
    const turning = {azimuth: 0.6, height: 0.35};
    this.views = [new View('body', turning, 1.3)];
    if (data.poinsot) {
      document.getElementById('poinsot-figure').hidden = false;
      this.views.push(new View('poinsot', turning, 1.55));
    }
    this.ghost = data.ghost && {times: unpacked(data.ghost.times, Float64Array),
      attitudes: unpacked(data.ghost.attitude, Float32Array), reach: data.ghost.reach};
    this.views.forEach((view) => this.listen(view));
    this.scales = ARROWS.map(([, , , vector]) => this.largest(vector));
    this.prepareCurves();
  }

  largest(vector) {
    const count = this.motion.times.length, stride = Math.max(1, Math.floor(count / 2000));
    let found = 0;
    for (let i = 0; i < count; i += stride)
      found = Math.max(found, length(vector(this.motion, this.motion.key(i))));
    return found;
  }

  listen(view) {
    let last = null;
    view.canvas.addEventListener('pointerdown', (event) => {
      last = [event.clientX, event.clientY];
      view.canvas.setPointerCapture(event.pointerId);
    });
    view.canvas.addEventListener('pointermove', (event) => {
      if (!last) return;
      view.turning.azimuth -= (event.clientX - last[0]) * 0.01;
      view.turning.height = Math.max(-1.55, Math.min(1.55,
        view.turning.height + (event.clientY - last[1]) * 0.01));
      last = [event.clientX, event.clientY];
      this.draw();
    });
    for (const name of ['pointerup', 'pointercancel'])
      view.canvas.addEventListener(name, () => { last = null; });
  }

  // Draw the polhode in body axes and the herpolhode in space axes. Where the samples are far
  // apart, draw dots instead of a line.
  prepareCurves() {
    if (!this.data.poinsot) return;
    const count = Math.min(this.motion.times.length, 4000);
    const states = Array.from({length: count}, (_, i) => this.motion.key(i));
    const turned = states.slice(1).map((one, i) => (one.time - states[i].time) * length(one.rate));
    this.dense = Math.max(0, ...turned) < 0.35;
    const energy = dot(states[0].rate, applied(this.data.inertia, states[0].rate));
    const smallest = Math.min(...this.data.moments);
    this.unit = 1.2 / Math.sqrt(energy / smallest);  // gives the longest semi-axis a length of 1.2
    this.semi = this.data.moments.map((moment) => this.unit * Math.sqrt(energy / moment));
    this.polhode = states.map((one) => times(this.unit, one.rate));
    this.herpolhode = states.map((one) => times(this.unit, rotated(one.attitude, one.rate)));
  }

  show(time) {
    this.state = this.motion.at(time);
    this.draw();
  }

  draw() {
    this.drawBody(this.views[0]);
    if (this.data.poinsot) this.drawPoinsot(this.views[1]);
  }

  drawBody(view) {
    const state = this.state;
    view.begin();
    this.drawSpaceAxes(view);
    this.drawBox(view);
    this.drawGhost(view);
    ['x', 'y', 'z'].forEach((name, k) => {
      const axis = rotated(state.attitude, [0, 1, 2].map((j) => (j === k ? 1.0 : 0)));
      view.arrow(axis, view.colour('ink'), [], name, 1.2);
    });
    ARROWS.forEach(([name, colour, dashes, vector, reach], k) => {
      const value = vector(this.motion, state);
      if (this.scales[k] && length(value) > 1e-3 * this.scales[k])
        view.arrow(times(reach / this.scales[k], value), view.colour(`c${colour}`), dashes,
          name.slice(-1));
    });
  }

  drawSpaceAxes(view) {
    ['X', 'Y', 'Z'].forEach((name, k) => view.arrow([0, 1, 2].map((j) => (j === k ? 1.2 : 0)),
      view.colour('quiet'), [2, 3], name, 1));
  }

  faces(view, attitude) {
    // Scale the box so that its corners are at a distance of 1 from the centre.
    const {sides, axes} = this.data, reach = length(sides);
    const corner = (signs) => rotated(attitude, sum(...signs.map(
      (sign, k) => times(sign * sides[k] / reach, axes[k]))));
    return [0, 1, 2].flatMap((k) => [-1, 1].map((sign) => {
      const [a, b] = [(k + 1) % 3, (k + 2) % 3];
      const points = [[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]].map(([p, q]) => {
        const signs = [];
        [signs[k], signs[a], signs[b]] = [sign, p, q];
        return corner(signs);
      });
      const normal = view.seen(rotated(attitude, times(sign, axes[k])));
      return {points, facing: normal[2], light: normal[1]};
    })).filter((one) => one.facing > 0);
  }

  drawBox(view) {
    const c = view.context;
    for (const face of this.faces(view, this.state.attitude)) {
      c.beginPath();
      face.points.forEach((point) => c.lineTo(...view.point(point)));
      c.globalAlpha = 0.55 + 0.3 * Math.max(0, face.light);
      c.fillStyle = view.colour('face');
      c.fill();
      c.globalAlpha = 1;
      view.path(face.points, view.colour('quiet'), [], 1);
    }
  }

  drawGhost(view) {  // the outline of the measured body, if there is a sample nearby
    if (!this.ghost) return;
    const {times: stamps, attitudes, reach} = this.ghost, now = this.state.time;
    let i = indexAt(stamps, now);
    if (i + 1 < stamps.length && stamps[i + 1] - now < now - stamps[i]) i++;
    if (Math.abs(stamps[i] - now) > reach) return;
    for (const face of this.faces(view, Array.from(attitudes.subarray(4 * i, 4 * i + 4))))
      view.path(face.points, view.colour('c4'), [], 1.8);
  }

  drawPoinsot(view) {
    view.begin();
    const {attitude} = this.state, {axes} = this.data;
    const inSpace = (v) => rotated(attitude, v);
    const circle = (build) => Array.from({length: 49}, (_, i) => inSpace(sum(
      ...build(i * Math.PI / 24).map((value, k) => times(value * this.semi[k], axes[k])))));
    for (const angle of [-0.9, -0.45, 0, 0.45, 0.9]) {
      const [s, c] = [Math.sin(angle), Math.cos(angle)];
      view.path(circle((t) => [c * Math.cos(t), c * Math.sin(t), s]), view.colour('faint'));
    }
    for (const angle of [0, Math.PI / 4, Math.PI / 2, 3 * Math.PI / 4]) {
      const [s, c] = [Math.sin(angle), Math.cos(angle)];
      view.path(circle((t) => [c * Math.cos(t), s * Math.cos(t), Math.sin(t)]),
        view.colour('faint'));
    }
    this.drawPlane(view);
    const now = inSpace(times(this.unit, this.state.rate));
    const draw = (points, colour, dashes) => (this.dense ? view.path(points, colour, dashes, 1.6)
      : view.dots(points, colour));
    draw(this.polhode.map(inSpace), view.colour('c4'), []);
    draw(this.herpolhode, view.colour('c2'), [6, 3]);
    const momentum = rotated(attitude, this.motion.momentum(this.state));
    view.arrow(times(1.45 / length(momentum), momentum), view.colour('c0'), [], 'L');
    view.arrow(now, view.colour('c1'), [7, 3], 'ω');
  }

  drawPlane(view) {  // the invariable plane, which contains the tip of the angular velocity
    const momentum = rotated(this.state.attitude, this.motion.momentum(this.state));
    const normal = times(1 / length(momentum), momentum);
    const rate = times(this.unit, rotated(this.state.attitude, this.state.rate));
    const middle = times(dot(rate, normal), normal);
    const other = Math.abs(normal[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    let side = cross(normal, other);
    side = times(1 / length(side), side);
    const across = cross(normal, side);
    view.path([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]].map(([p, q]) =>
      sum(middle, times(p, side), times(q, across))), view.colour('quiet'), [], 1);
  }
}

class Player {
  constructor(scene) {
    this.scene = scene;
    this.end = scene.motion.end;
    this.time = 0;
    [this.play, this.slider, this.clock, this.speed] = ['play', 'time', 'clock', 'speed'].map(
      (name) => document.getElementById(name));
    this.slider.max = this.end;
    this.addSpeeds();
    this.group = groups[page.panels[0].xLabel];
    this.follow = (time) => this.set(time);
    if (this.group) this.group.listeners.push(this.follow);
    this.slider.addEventListener('input', () => this.set(Number(this.slider.value)));
    this.play.addEventListener('click', () => this.toggle());
    addEventListener('keydown', (event) => {
      if (event.key === ' ' && !/BUTTON|SELECT/.test(event.target.tagName)) {
        event.preventDefault();
        this.toggle();
      }
    });
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => scene.draw());
    addEventListener('resize', () => scene.draw());
    this.set(0);
  }

  // Offer a range of speeds. The default is 1, or a power of ten at which the whole motion takes
  // at most a minute.
  addSpeeds() {
    const fitting = 10 ** Math.ceil(Math.log10(Math.max(this.end, 1e-9) / 60) - 1e-6);
    const chosen = this.end > 2 ? Math.max(1, fitting) : fitting;
    for (const factor of [0.01, 0.1, 0.3, 1, 3, 10, 100]) {
      const option = html('option', this.speed, `× ${Number((chosen * factor).toPrecision(3))}`);
      option.value = chosen * factor;
      option.selected = factor === 1;
    }
  }

  // Move the clock to a time. If the body can only be shown at the nearest computed state, the
  // cursor is placed there as well.
  set(time) {
    this.time = Math.max(0, Math.min(time, this.end));
    this.scene.show(this.time);
    this.slider.value = this.time;
    const shown = this.scene.state.time;
    this.clock.textContent = `${written(shown, 10 ** Math.floor(Math.log10(this.end || 1) - 3))} s`;
    if (this.group && this.group.cursor !== shown)
      this.group.moveCursor(shown, this.follow);
  }

  toggle() {
    this.playing = !this.playing;
    this.play.textContent = this.playing ? 'Pause' : 'Play';
    this.play.setAttribute('aria-pressed', this.playing);
    if (!this.playing) return;
    if (this.time >= this.end) this.set(0);
    let last = performance.now();
    const frame = (now) => {
      if (!this.playing) return;
      this.set(this.time + (now - last) * 1e-3 * Number(this.speed.value));
      last = now;
      if (this.time >= this.end) this.toggle(); else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  // Return what the page shows: the time, s, and the attitude x y z w at this time.
  shown() {
    return {time: this.scene.state.time, attitude: this.scene.state.attitude};
  }
}

let motion = null;
if (page.body) {
  const scene = new Scene(page.body), list = document.getElementById('arrows');
  const ghost = page.body.ghost ? [['the measured body', 4, []]] : [];
  for (const [name, colour, dashes] of [...ARROWS, ...ghost]) {
    const item = html('li', list);
    const line = element('svg', {viewBox: '0 0 30 10', 'aria-hidden': 'true'}, item);
    element('line', {x1: 0, x2: 30, y1: 5, y2: 5, 'stroke-width': 2.5, class: `c${colour}`,
      'stroke-dasharray': dashes.join(' ')}, line);
    html('span', item, name);
  }
  html('li', list, 'x y z: body axes');
  html('li', list, 'X Y Z: space axes (dotted)');
  motion = new Player(scene);
}
performance.mark('ready');
document.body.dataset.ready = performance.now();
