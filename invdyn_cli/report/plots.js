/* Draws the plots of a page from their data: panels over a shared time axis, clouds linked to it, the arm's posture. */
"use strict";
(() => {
  const LEFT = 62, RIGHT = 8, TOP = 6, BOTTOM = 20;
  const style = getComputedStyle(document.documentElement);
  const colour = name => style.getPropertyValue("--" + name).trim() || name;
  const floats = ({ b, low, step }) => { /* numbers of `interactive._packed` */
    const bytes = Uint8Array.from(atob(b), c => c.charCodeAt(0)).buffer;
    return step ? Float32Array.from(new Uint16Array(bytes), k => k === 65535 ? NaN : low + k * step) : new Float32Array(bytes);
  };
  const clamp = (x, low, high) => Math.max(low, Math.min(high, x));
  const make = (tag, parent, kind, text) => {
    const made = document.createElement(tag);
    if (kind) made.className = kind;
    if (text !== undefined) made.textContent = text;
    return parent.appendChild(made);
  };
  const digits = x => Number.isFinite(x) ? (x === 0 || (Math.abs(x) >= 1e-3 && Math.abs(x) < 1e6)
    ? String(Number(x.toPrecision(4))) : x.toExponential(2)).replace("-", "\u2212") : "\u2013";
  const nearest = (t, x) => { /* index of the value of ascending t that is closest to x */
    let low = 0, high = t.length - 1;
    while (high - low > 1) { const k = (low + high) >> 1; if (t[k] < x) low = k; else high = k; }
    return Math.abs(t[low] - x) <= Math.abs(t[high] - x) ? low : high;
  };
  const ticks = (low, high, most, fewest = 2) => { /* round numbers between two limits, and their decimals */
    const raw = (high - low) / Math.max(1, most), scale = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map(x => x * scale).find(x => x >= raw * 0.999) || 10 * scale, out = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step && out.length < 50; k++) out.push(k * step);
    if (out.length < fewest && most < 20) return ticks(low, high, most + 1, fewest);
    return out.map(x => [x, Math.abs(x) >= 1e5 || (x && step < 1e-4) ? digits(x)
      : x.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "\u2212")]);
  };
  const widened = (low, high) => {
    if (!(low <= high)) return [-1, 1];
    const margin = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
    return [low - margin, high + margin];
  };
  const range = (y, from, to) => {
    let low = Infinity, high = -Infinity;
    for (let k = from; k <= to; k++) if (y[k] === y[k]) { if (y[k] < low) low = y[k]; if (y[k] > high) high = y[k]; }
    return [low, high];
  };

  class Area { /* a canvas with axes, and one above it for what follows the pointer */
    constructor(parent, height, words) {
      this.box = make("div", parent, "area");
      this.box.style.height = height + "px";
      this.below = make("canvas", this.box);
      this.above = make("canvas", this.box);
      this.above.setAttribute("role", "img");
      this.above.setAttribute("aria-label", words);
    }
    sized() { /* fits both to the place and the screen; false without a place */
      this.w = this.box.clientWidth; this.h = this.box.clientHeight;
      const dense = window.devicePixelRatio || 1;
      for (const c of [this.below, this.above]) {
        c.width = Math.round(this.w * dense); c.height = Math.round(this.h * dense);
        c.getContext("2d").setTransform(dense, 0, 0, dense, 0, 0);
      }
      this.g = this.below.getContext("2d"); this.over = this.above.getContext("2d");
      this.g.font = this.over.font = "11px system-ui, sans-serif";
      return this.w > LEFT + RIGHT + 20;
    }
    limits(x, y) { this.xs = x; this.ys = y; }
    px(x) { return LEFT + (x - this.xs[0]) / (this.xs[1] - this.xs[0]) * (this.w - LEFT - RIGHT); }
    py(y) { return this.h - BOTTOM - (y - this.ys[0]) / (this.ys[1] - this.ys[0]) * (this.h - TOP - BOTTOM); }
    x(px) { return this.xs[0] + (px - LEFT) / (this.w - LEFT - RIGHT) * (this.xs[1] - this.xs[0]); }
    y(py) { return this.ys[0] + (this.h - BOTTOM - py) / (this.h - TOP - BOTTOM) * (this.ys[1] - this.ys[0]); }
    frame(xLabel, yLabel) {
      const g = this.g, floor = this.h - BOTTOM;
      g.clearRect(0, 0, this.w, this.h);
      g.fillStyle = colour("soft"); g.lineWidth = 1;
      const line = (a, b, c, d, name) => {
        g.strokeStyle = colour(name); g.beginPath(); g.moveTo(a, b); g.lineTo(c, d); g.stroke();
      };
      g.textAlign = "right"; g.textBaseline = "middle";
      for (const [y, text] of ticks(...this.ys, (floor - TOP) / 26)) {
        line(LEFT, this.py(y), this.w - RIGHT, this.py(y), y === 0 ? "soft" : "grid");
        g.fillText(text, LEFT - 5, this.py(y));
      }
      const room = g.measureText(xLabel).width;
      g.textAlign = "right"; g.textBaseline = "alphabetic";
      g.fillText(xLabel, this.w - RIGHT, this.h - 5);
      g.textAlign = "center";
      for (const [x, text] of ticks(...this.xs, (this.w - LEFT - RIGHT) / 85)) {
        line(this.px(x), TOP, this.px(x), floor, "grid");
        if (this.px(x) + g.measureText(text).width / 2 < this.w - RIGHT - room - 8) g.fillText(text, this.px(x), this.h - 5);
      }
      line(LEFT, floor, this.w - RIGHT, floor, "soft");
      g.save(); g.translate(11, (TOP + floor) / 2); g.rotate(-Math.PI / 2); g.textBaseline = "middle";
      g.fillText(yLabel, 0, 0, this.h - 8); g.restore();
    }
    clip() { const g = this.g; g.save(); g.beginPath(); g.rect(LEFT, TOP - 2, this.w - LEFT - RIGHT, this.h - TOP - BOTTOM + 4); g.clip(); }
    curve(t, y, from, to, look) {
      const g = this.g;
      g.strokeStyle = colour(look.colour); g.lineWidth = look.width || 1.6; g.lineJoin = "round";
      g.beginPath();
      for (let k = from, on = false; k <= to; k++) {
        if (y[k] !== y[k]) { on = false; continue; }
        const a = this.px(t[k]), b = clamp(this.py(y[k]), -1e4, 1e4);
        if (on) g.lineTo(a, b); else { g.moveTo(a, b); if (!(y[k + 1] === y[k + 1])) g.lineTo(a + 1, b); }
        on = true;
      }
      g.stroke();
    }
    selected(a, b) { /* a box between two corners, in pixels */
      this.over.fillStyle = colour("blue"); this.over.globalAlpha = 0.18;
      this.over.fillRect(a[0], a[1], b[0] - a[0], b[1] - a[1]); this.over.globalAlpha = 1;
    }
    drags(both, chosen, moved, whole) { /* a box or a span chosen by dragging; `moved` follows, a double click resets */
      const c = this.above;
      let from = null;
      const at = e => { const r = c.getBoundingClientRect(); return [clamp(e.clientX - r.left, LEFT, this.w - RIGHT), clamp(e.clientY - r.top, TOP, this.h - BOTTOM)]; };
      c.addEventListener("pointerdown", e => { if (e.button) return; from = at(e); c.setPointerCapture(e.pointerId); moved(from); });
      c.addEventListener("pointermove", e => {
        const p = at(e);
        moved(p);
        if (from && Math.abs(p[0] - from[0]) > 5) this.selected(both ? from : [from[0], TOP], both ? p : [p[0], this.h - BOTTOM]);
      });
      c.addEventListener("pointerup", e => {
        const a = from, b = at(e);
        from = null;
        if (!a || Math.abs(b[0] - a[0]) <= 5 || (both && Math.abs(b[1] - a[1]) <= 5)) return;
        const sort = (x, y) => x < y ? [x, y] : [y, x];
        chosen(sort(this.x(a[0]), this.x(b[0])), sort(this.y(a[1]), this.y(b[1])));
      });
      c.addEventListener("pointercancel", () => { from = null; });
      c.addEventListener("dblclick", whole);
    }
    clear() { this.over.clearRect(0, 0, this.w, this.h); }
  }

  class Figure {
    constructor(place) {
      const d = JSON.parse(place.querySelector("script").textContent);
      Object.assign(this, { place, d, t: floats(d.t), lit: null });
      this.whole = this.t.length > 1 ? [this.t[0], this.t[this.t.length - 1]] : [0, 1];
      this.span = [...this.whole]; this.cursor = this.whole[0];
      this.bar(make("div", place, "tools"));
      const main = make("div", place, "main"), body = make("div", main, "body");
      this.panels = d.panels.map((p, k) => this.panel(body, p, k === d.panels.length - 1));
      if (d.clouds.length) {
        const grid = make("div", place, "clouds");
        this.cloudT = floats(d.cloud_t);
        this.clouds = d.clouds.map(c => this.cloud(grid, c));
        make("p", place, "note", d.note);
      } else this.clouds = [];
      if (d.arm) this.arm = new Arm(main, d.arm, d.label);
      place.closest("figure").classList.add("live");
      document.documentElement.classList.add("plotted");
      new ResizeObserver(() => this.draw()).observe(body);
      this.draw();
    }
    bar(tools) {
      const button = (text, said, act) => { const b = make("button", tools, "", text); b.type = "button"; b.title = said; b.setAttribute("aria-label", said); b.onclick = act; return b; };
      button("+", "zoom in", () => this.zoom(0.5));
      button("\u2212", "zoom out", () => this.zoom(2));
      button("\u25c2", "earlier", () => this.pan(-0.5));
      button("\u25b8", "later", () => this.pan(0.5));
      button("whole", "show all of the time", () => this.show(...this.whole));
      this.play = button("play", "move the cursor in real time", () => this.run());
      this.words = make("output", tools, "when");
      make("span", tools, "hint", "Drag: zoom. Double-click: all. Arrow keys: cursor."
        + (this.d.every > 1 ? ` Drawn: the lowest and highest of every ${this.d.every} samples.` : ""));
    }
    panel(body, p, last) {
      const lines = p.lines.map(x => ({ ...x, y: floats(x.y) }));
      const head = make("div", body, "head"), key = {};
      if (p.title) make("b", head, "", p.title);
      const outs = lines.map(x => {
        const one = make("span", head, "key"), swatch = make("i", one);
        swatch.style.background = `var(--${x.colour})`;
        make("span", one, "", x.name);
        return make("output", one);
      });
      for (const m of p.marks) if (!key[m.name]) {
        key[m.name] = make("span", head, "key");
        make("i", key[m.name], "mark").style.background = `var(--${m.colour})`;
        make("span", key[m.name], "", m.name);
      }
      if (p.note) make("span", head, "said", p.note);
      const area = new Area(body, p.height, `${p.title} ${p.quantity} over time`), made = { p, lines, outs, area, last };
      area.above.tabIndex = 0;
      area.drags(false, x => this.show(...x), at => { this.lit = p.joint; this.point(area.x(at[0])); }, () => this.show(...this.whole));
      area.above.addEventListener("wheel", e => { if (e.ctrlKey) { e.preventDefault(); this.zoom(e.deltaY > 0 ? 1.25 : 0.8, area.x(e.offsetX)); } }, { passive: false });
      area.above.addEventListener("keydown", e => {
        const step = (this.span[1] - this.span[0]) / (e.shiftKey ? 20 : 200);
        const act = { ArrowLeft: () => this.point(this.cursor - step), ArrowRight: () => this.point(this.cursor + step), "+": () => this.zoom(0.5), "-": () => this.zoom(2), Escape: () => this.show(...this.whole) }[e.key];
        if (act) { e.preventDefault(); act(); }
      });
      return made;
    }
    cloud(grid, c) {
      const cell = make("div", grid), unpack = x => ({ ...x, x: floats(x.x), y: floats(x.y) });
      const head = make("div", cell, "head");
      make("b", head, "", c.title);
      const points = c.points.map(unpack), curves = c.curves.map(unpack);
      for (const x of [...points, ...curves]) {
        const one = make("span", head, "key");
        make("i", one, points.includes(x) ? "dot" : "").style.background = `var(--${x.colour})`;
        make("span", one, "", x.name);
      }
      const made = { c, points, curves, area: new Area(cell, 210, `${c.title}: ${c.y_label} over ${c.x_label}`), box: null };
      made.area.drags(true, (x, y) => { made.box = [x, y]; this.drawCloud(made); this.point(this.cursor); }, () => { this.lit = c.joint; this.point(this.cursor); }, () => { made.box = null; this.drawCloud(made); this.point(this.cursor); });
      return made;
    }
    show(a, b) {
      const least = (this.whole[1] - this.whole[0]) / Math.max(10, this.t.length / 4), wide = clamp(b - a, least, this.whole[1] - this.whole[0]);
      a = clamp((a + b - wide) / 2, this.whole[0], this.whole[1] - wide);
      this.span = [a, a + wide];
      this.draw();
    }
    zoom(by, about) {
      const [a, b] = this.span, c = about ?? (this.cursor >= a && this.cursor <= b ? this.cursor : (a + b) / 2);
      this.show(c + (a - c) * by, c + (b - c) * by);
    }
    pan(by) { const w = by * (this.span[1] - this.span[0]); this.show(this.span[0] + w, this.span[1] + w); }
    run() {
      if (this.running) { cancelAnimationFrame(this.running); this.running = 0; this.play.textContent = "play"; return; }
      this.play.textContent = "stop";
      let last = null;
      const tick = now => {
        const next = this.cursor + (last === null ? 0 : (now - last) / 1000);
        last = now;
        if (next > this.span[1]) { this.point(this.span[0]); this.run(); return; }
        this.point(next);
        this.running = requestAnimationFrame(tick);
      };
      if (this.cursor < this.span[0] || this.cursor >= this.span[1]) this.cursor = this.span[0];
      this.running = requestAnimationFrame(tick);
    }
    draw() {
      this.from = Math.max(0, nearest(this.t, this.span[0]) - 1);
      this.to = Math.min(this.t.length - 1, nearest(this.t, this.span[1]) + 1);
      for (const p of this.panels) this.drawPanel(p);
      for (const c of this.clouds) this.drawCloud(c);
      this.point(this.cursor);
    }
    drawPanel({ p, lines, area, last }) {
      if (!area.sized()) return;
      let low = Infinity, high = -Infinity;
      for (const all of [lines.filter(x => x.frames), lines]) {
        const span = high - low;
        const found = all.map(x => range(x.y, this.from, this.to));
        const [a, b] = [Math.min(...found.map(x => x[0])), Math.max(...found.map(x => x[1]))];
        if (low <= high && span > 0) { low = Math.max(Math.min(low, a), low - span); high = Math.min(Math.max(high, b), high + span); }
        else { low = a; high = b; }
      }
      if (p.zero) { low = -Math.max(Math.abs(low), Math.abs(high)); high = -low; }
      area.limits(this.span.map(x => x + this.d.start), widened(low, high));
      area.frame(last || p.zero ? this.d.time : "", p.quantity);
      area.limits(this.span, area.ys);
      const g = area.g, bottom = area.h - BOTTOM;
      area.clip();
      for (const m of p.marks) for (const [a, b] of m.spans || []) {
        g.fillStyle = colour(m.colour); g.globalAlpha = 0.3;
        g.fillRect(area.px(a), TOP, Math.max(1.5, area.px(b) - area.px(a)), bottom - TOP); g.globalAlpha = 1;
      }
      const begins = [...(this.d.parts.length > 1 ? this.d.parts : []).map(x => [x[0], x[1]]), ...this.d.stages].sort((x, y) => x[1] - y[1]);
      for (const [name, at] of begins) {
        g.strokeStyle = g.fillStyle = colour("soft"); g.lineWidth = 1; g.setLineDash([2, 3]);
        g.beginPath(); g.moveTo(area.px(at), TOP); g.lineTo(area.px(at), bottom); g.stroke(); g.setLineDash([]);
      }
      for (const x of lines) area.curve(this.t, x.y, this.from, this.to, x);
      for (const m of p.marks) for (const [a, y] of m.at || []) {
        const b = y === null ? TOP + 5 : clamp(area.py(y), TOP + 4, bottom - 4), c = area.px(a);
        g.strokeStyle = colour(m.colour); g.lineWidth = 1.8; g.beginPath();
        g.moveTo(c - 4, b - 4); g.lineTo(c + 4, b + 4); g.moveTo(c + 4, b - 4); g.lineTo(c - 4, b + 4); g.stroke();
      }
      g.textAlign = "left"; g.textBaseline = "top"; g.fillStyle = colour("soft");
      let free = 0;
      for (const [name, at] of begins) if (area.px(at) >= free) { g.fillText(name, area.px(at) + 3, TOP); free = area.px(at) + g.measureText(name).width + 10; }
      g.restore();
    }
    drawCloud(one) {
      const { c, points, curves, area, box } = one;
      if (!area.sized()) return;
      const ends = key => {
        const found = points.map(x => range(x[key], 0, x[key].length - 1));
        return widened(Math.min(...found.map(x => x[0])), Math.max(...found.map(x => x[1])));
      };
      let x = ends("x"), y = ends("y");
      if (c.diagonal) x = y = [Math.min(x[0], y[0]), Math.max(x[1], y[1])];
      area.limits(...(box || [x, y]));
      area.frame(c.x_label, c.y_label);
      area.clip();
      const g = area.g;
      if (c.diagonal) area.curve(x, x, 0, 1, { colour: "grey", width: 1 });
      for (const inside of [false, true]) for (const p of points) {
        g.fillStyle = colour(inside ? p.colour : "grey"); g.globalAlpha = inside ? 0.7 : 0.25;
        for (let k = 0; k < p.x.length; k++) {
          if ((this.cloudT[k] >= this.span[0] && this.cloudT[k] <= this.span[1]) === inside) g.fillRect(area.px(p.x[k]) - 1, area.py(p.y[k]) - 1, 2.2, 2.2);
        }
      }
      g.globalAlpha = 1;
      for (const x of curves) area.curve(x.x, x.y, 0, x.x.length - 1, { colour: x.colour, width: 2 });
      g.restore();
    }
    point(t) { /* the cursor at a time: a line in every panel, the values in the keys, the arm's posture */
      this.cursor = t = clamp(t, ...this.whole);
      if (!this.t.length) return;
      const k = nearest(this.t, t), [a, b] = this.span;
      for (const { lines, outs, area } of this.panels) {
        if (!area.xs) continue;
        area.clear();
        lines.forEach((x, i) => { outs[i].textContent = digits(x.y[k]); });
        if (t < a || t > b) continue;
        const g = area.over;
        g.strokeStyle = colour("ink"); g.lineWidth = 1; g.beginPath(); g.moveTo(area.px(t), TOP); g.lineTo(area.px(t), area.h - BOTTOM); g.stroke();
        for (const x of lines) if (x.y[k] === x.y[k]) { g.fillStyle = colour(x.colour); g.beginPath(); g.arc(area.px(this.t[k]), clamp(area.py(x.y[k]), TOP, area.h - BOTTOM), 3, 0, 7); g.fill(); }
      }
      const row = this.clouds.length ? nearest(this.cloudT, t) : 0;
      for (const { points, area } of this.clouds) if (area.xs) {
        area.clear();
        for (const p of points) { const g = area.over; g.strokeStyle = colour("ink"); g.lineWidth = 1.5; g.beginPath(); g.arc(area.px(p.x[row]), area.py(p.y[row]), 4.5, 0, 7); if (p.x[row] >= area.xs[0] && p.x[row] <= area.xs[1]) g.stroke(); }
      }
      const part = this.d.parts.filter(x => x[1] <= t).pop() || this.d.parts[0], zero = this.d.start;
      const own = part ? `${(t + zero + part[2]).toFixed(3)} s in ${part[0]}` : "";
      this.words.textContent = own;
      if (this.arm) this.arm.draw(t, this.lit, own);
    }
  }

  class Arm { /* a stick figure that can be turned */
    constructor(parent, d, label) {
      Object.assign(this, { d, t: floats(d.t), points: floats(d.points), n: d.parents.length, yaw: 0.7, pitch: 0.35 });
      this.place = make("div", parent, "arm");
      this.area = new Area(this.place, 0, `the arm's posture: ${label}`);
      this.area.box.style.height = "";
      this.words = make("div", this.place, "sub", "");
      this.low = [Infinity, Infinity, Infinity]; this.high = [-Infinity, -Infinity, -Infinity];
      for (let k = 0; k < this.points.length; k++) { const a = k % 3; this.low[a] = Math.min(this.low[a], this.points[k]); this.high[a] = Math.max(this.high[a], this.points[k]); }
      const c = this.area.above;
      c.addEventListener("pointerdown", e => { this.from = [e.clientX, e.clientY]; c.setPointerCapture(e.pointerId); });
      c.addEventListener("pointermove", e => {
        if (!this.from) return;
        this.yaw += (e.clientX - this.from[0]) / 90; this.pitch = clamp(this.pitch + (e.clientY - this.from[1]) / 90, -1.5, 1.5);
        this.from = [e.clientX, e.clientY]; this.draw(...this.last);
      });
      for (const end of ["pointerup", "pointercancel"]) c.addEventListener(end, () => { this.from = null; });
    }
    draw(t, lit, own) {
      this.last = [t, lit, own];
      if (!this.area.sized()) return;
      const { area: { g, w, h }, n, points } = this, k = nearest(this.t, t);
      const other = clamp(this.t[k] <= t ? k + 1 : k - 1, 0, this.t.length - 1), gap = this.t[other] - this.t[k];
      const share = gap ? clamp((t - this.t[k]) / gap, 0, 1) : 0;
      const middle = this.low.map((x, a) => (x + this.high[a]) / 2), size = Math.hypot(...this.low.map((x, a) => this.high[a] - x)) || 1;
      const scale = 0.92 * Math.min(w, h) / size, [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
      const seen = p => {
        const [x, y, z] = p.map((v, a) => v - middle[a]), side = x * cy - y * sy, deep = x * sy + y * cy;
        return [w / 2 + scale * side, h / 2 - scale * (z * cp + deep * sp)];
      };
      const path = (ps, name, wide) => { g.strokeStyle = colour(name); g.lineWidth = wide; g.lineCap = "round"; g.beginPath(); ps.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p)); g.stroke(); };
      g.clearRect(0, 0, w, h);
      const floor = Math.min(0, this.low[2]), step = size > 2.5 ? 0.5 : size > 0.6 ? 0.2 : size / 6, reach = 3 * step;
      for (let i = -3; i <= 3; i++) { path([seen([i * step, -reach, floor]), seen([i * step, reach, floor])], "grid", 1); path([seen([-reach, i * step, floor]), seen([reach, i * step, floor])], "grid", 1); }
      const at = i => seen([0, 1, 2].map(a => { const v = points[(k * n + i) * 3 + a]; return v + share * (points[(other * n + i) * 3 + a] - v); }));
      if (floor < 0) path([seen([0, 0, floor]), at(0)], "soft", 2);
      this.d.parents.forEach((p, i) => { if (p >= 0) path([at(p), at(i)], i > this.d.joints.length ? "soft" : "ink", i > this.d.joints.length ? 3 : 5); });
      this.d.joints.forEach((name, j) => {
        const [x, y] = at(j + 1), on = j === lit;
        g.beginPath(); g.arc(x, y, on ? 7 : 4.5, 0, 7); g.fillStyle = colour(on ? "vermillion" : "ground"); g.fill(); g.strokeStyle = colour(on ? "vermillion" : "ink"); g.lineWidth = 2; g.stroke();
      });
      this.words.textContent = own + (lit === null || lit === undefined ? "" : `, ${this.d.joints[lit]} lit`) + `; grid ${digits(step)} m; drag to turn`;
    }
  }

  const figures = [...document.querySelectorAll(".plots")].map(place => new Figure(place));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => figures.forEach(f => f.draw()));
})();
