"use strict";
/* Zoomable plots on canvas. Drag: zoom; shift and drag: move; double click: all; wheel: zoom once the plot is clicked.
   Keys in a focused plot: arrows move, + and - zoom, 0 shows all. Plots of one group share their horizontal axis. */
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const FONT = "12px system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif"; /* as .stage text */
  const MARGIN = { left: 64, right: 12, top: 8, bottom: 38 }, NARROW = { ...MARGIN, left: 52 };
  const MISSING = -32768;
  /* Colours are those of the style sheet, in whichever mode the page is shown. */
  const style = getComputedStyle(document.documentElement);
  const paint = name => style.getPropertyValue(`--${name}`).trim();

  const unpack = ({ offset, scale, data }) => {
    const bytes = Uint8Array.from(atob(data), c => c.charCodeAt(0));
    const view = new DataView(bytes.buffer), out = new Float64Array(bytes.length / 2);
    for (let i = 0; i < out.length; i++) {
      const v = view.getInt16(2 * i, true);
      out[i] = v === MISSING ? NaN : offset + scale * v;
    }
    return out;
  };
  const list = values => Float64Array.from(values, v => (v === null ? NaN : v));
  const clamp = (v, low, high) => Math.min(Math.max(v, low), high);

  const number = (v, step) => {
    if (!isFinite(v)) return "–";
    const size = Math.max(Math.abs(v), step);
    const text = size >= 1e6 || size < 1e-4 ? v.toExponential(2)
      : v.toFixed(clamp(Math.ceil(-Math.log10(step) - 1e-9), 0, 9));
    return text.replace("-", "−");
  };

  const ticks = (low, high, count) => {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find(m => m * power >= raw * 0.999);
    const values = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
    return values.map(v => ({ v, text: number(v, step) }));
  };
  const decades = (low, high, room) => {
    const whole = Math.log10(high) - Math.log10(low), values = [];
    const steps = whole > 0.6 * room ? [1] : whole > 0.3 * room ? [1, 3] : [1, 2, 5];
    if (whole < 0.8) return ticks(low, high, room);
    for (let p = Math.floor(Math.log10(low)); p <= Math.log10(high); p++)
      for (const m of steps) {
        const v = m * 10 ** p;
        if (v >= low * 0.999 && v <= high * 1.001) values.push({ v, text: number(v, Math.min(v, 1)) });
      }
    return values;
  };

  class Plot {
    constructor(canvas, spec, group) {
      this.canvas = canvas; this.spec = spec; this.group = group;
      this.context = canvas.getContext("2d");
      this.labels = canvas.parentElement.querySelector("svg");
      this.hidden = new Set();
      this.xScale = spec.xLog ? Math.log : v => v; this.xBack = spec.xLog ? Math.exp : v => v;
      this.yScale = spec.yLog ? Math.log : v => v; this.yBack = spec.yLog ? Math.exp : v => v;
      this.full = this.extent(); this.y = null;
      if (!group.x) group.x = this.full.slice();
      group.plots.push(this);
      this.listen(); this.legend();
      new ResizeObserver(() => this.draw()).observe(canvas);
    }
    get x() { return this.group.x; }

    extent() {
      const { spec } = this;
      if (spec.uniform) return [spec.start, spec.start + spec.step * (spec.series[0].y.length - 1)];
      let low = Infinity, high = -Infinity;
      for (const s of spec.series) for (const v of s.x) if (isFinite(v) && (!spec.xLog || v > 0)) {
        low = Math.min(low, v); high = Math.max(high, v);
      }
      if (!(low < high)) return spec.xLog ? [1, 10] : [0, 1];
      return [this.xScale(low), this.xScale(high)];
    }
    /* Vertical range of what is in sight; clouds by their quantiles, so that one sample does not squeeze the rest. */
    range() {
      if (this.y) return this.y;
      const [left, right] = this.x, { spec } = this;
      let low = Infinity, high = -Infinity;
      for (const s of spec.series) {
        if (this.hidden.has(s.name)) continue;
        const [first, last] = this.visible(s, left, right), seen = [];
        for (let i = first; i < last; i++) {
          if (s.x && !(this.xScale(s.x[i]) >= left && this.xScale(s.x[i]) <= right)) continue;
          const v = s.y[i];
          if (!isFinite(v) || (spec.yLog && v <= 0)) continue;
          if (s.cloud) seen.push(v); else { low = Math.min(low, v); high = Math.max(high, v); }
        }
        if (seen.length) {
          seen.sort((a, b) => a - b);
          low = Math.min(low, seen[Math.floor(0.004 * (seen.length - 1))]);
          high = Math.max(high, seen[Math.ceil(0.996 * (seen.length - 1))]);
        }
      }
      if (!(low <= high)) return [0, 1];
      if (spec.yLog) return [Math.log(Math.max(low, high * 1e-4)) - 0.1, Math.log(high) + 0.2];
      if (spec.zero) { low = Math.min(low, 0); high = Math.max(high, 0); }
      const pad = 0.06 * (high - low) || 0.5 * Math.abs(high) || 1;
      return [low - pad, high + pad];
    }
    visible(s, left, right) {
      const n = s.y.length;
      if (s.x) return [0, n];
      const { start, step } = this.spec;
      return [clamp(Math.floor((left - start) / step), 0, n), clamp(Math.ceil((right - start) / step) + 1, 0, n)];
    }
    draw() {
      const { canvas, context: c, spec } = this, ratio = window.devicePixelRatio || 1;
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width || !height) return;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
      }
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.clearRect(0, 0, width, height);
      const [x0, x1] = this.x, [y0, y1] = this.shown = this.range();
      const margin = width < 420 ? NARROW : MARGIN, box = this.box = { top: margin.top, bottom: height - margin.bottom };
      const high = Math.max(3, Math.floor((box.bottom - box.top) / 30));
      const yTicks = spec.yLog ? decades(Math.exp(y0), Math.exp(y1), high) : ticks(y0, y1, high);
      c.font = FONT;
      const widest = Math.max(...yTicks.map(({ text }) => c.measureText(text).width), 0);
      box.left = Math.max(margin.left, Math.ceil(widest) + 27); box.right = width - margin.right;
      const wide = Math.max(2, Math.floor((box.right - box.left) / 60));
      const xTicks = spec.xLog ? decades(Math.exp(x0), Math.exp(x1), wide) : ticks(x0, x1, wide);
      const px = v => box.left + (this.xScale(v) - x0) / (x1 - x0) * (box.right - box.left);
      const py = v => box.bottom - (this.yScale(v) - y0) / (y1 - y0) * (box.bottom - box.top);
      this.px = px; this.py = py;

      for (const [a, b] of spec.shaded || []) {
        const l = clamp(px(a), box.left, box.right), r = clamp(px(b), box.left, box.right);
        if (r > l) { c.fillStyle = paint("held"); c.fillRect(l, box.top, Math.max(r - l, 0.5), box.bottom - box.top); }
      }
      c.lineWidth = 1; c.strokeStyle = paint("grid");
      c.beginPath();
      for (const { v } of xTicks) { const p = Math.round(px(v)) + 0.5; c.moveTo(p, box.top); c.lineTo(p, box.bottom); }
      for (const { v } of yTicks) { const p = Math.round(py(v)) + 0.5; c.moveTo(box.left, p); c.lineTo(box.right, p); }
      c.stroke();
      if (!spec.yLog && y0 < 0 && y1 > 0) {
        c.strokeStyle = paint("zero"); c.beginPath();
        c.moveTo(box.left, Math.round(py(0)) + 0.5); c.lineTo(box.right, Math.round(py(0)) + 0.5); c.stroke();
      }
      this.label(width, height, xTicks, yTicks);

      c.save(); c.beginPath();
      c.rect(box.left, box.top, box.right - box.left, box.bottom - box.top); c.clip();
      for (const s of spec.series) if (!this.hidden.has(s.name)) {
        if (s.cloud) this.cloud(s); else if (s.x) this.curve(s); else this.line(s);
      }
      c.restore();
      c.strokeStyle = paint("zero"); c.strokeRect(box.left + 0.5, box.top + 0.5, box.right - box.left - 1, box.bottom - box.top - 1);
      this.overlay();
    }
    /* Text is SVG over the canvas: it takes the page's colours, and none of it leaves the plot or covers another. */
    label(width, height, xTicks, yTicks) {
      const { box, context: c, spec } = this, texts = [], half = text => c.measureText(text).width / 2 + 1;
      const put = (kind, text, x, y, turned) => {
        const node = document.createElementNS(this.labels.namespaceURI, "text");
        node.setAttribute("class", kind); node.setAttribute("x", x); node.setAttribute("y", y);
        node.setAttribute("text-anchor", kind === "y tick" ? "end" : "middle");
        if (turned) node.setAttribute("transform", `rotate(-90 ${x} ${y})`);
        node.textContent = text; texts.push(node);
      };
      c.font = FONT;
      let end = -Infinity;
      for (const { v, text } of xTicks) {
        const x = clamp(this.px(v), half(text), width - half(text));
        if (x - half(text) < end + 8) continue;
        end = x + half(text);
        put("x tick", text, x, box.bottom + 15);
      }
      let above = Infinity;
      for (const { v, text } of yTicks) {
        const y = clamp(this.py(v) + 4, 11, height - 3);
        if (y > above - 13) continue;
        above = y;
        put("y tick", text, box.left - 7, y);
      }
      const middle = (low, high, text, whole) => clamp((low + high) / 2, half(text), Math.max(half(text), whole - half(text)));
      put("axis", spec.xLabel, middle(box.left, box.right, spec.xLabel, width), height - 5);
      put("axis", spec.yLabel, 14, middle(box.top, box.bottom, spec.yLabel, height), true);
      this.labels.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.labels.replaceChildren(...texts);
    }
    cloud(s) {
      const { context: c } = this;
      c.fillStyle = paint(s.role); c.globalAlpha = s.alpha || 0.16;
      for (let i = 0; i < s.y.length; i++) if (isFinite(s.y[i])) c.fillRect(this.px(s.x[i]) - 1, this.py(s.y[i]) - 1, 2, 2);
      c.globalAlpha = 1;
    }
    curve(s) {
      const { context: c } = this;
      const path = () => {
        c.beginPath();
        let on = false;
        for (let i = 0; i < s.y.length; i++) {
          const good = isFinite(s.y[i]) && (!this.spec.yLog || s.y[i] > 0);
          if (good) { if (on) c.lineTo(this.px(s.x[i]), this.py(s.y[i])); else c.moveTo(this.px(s.x[i]), this.py(s.y[i])); }
          on = good;
        }
      };
      c.lineJoin = "round";
      if (s.cased) { path(); c.strokeStyle = paint("paper"); c.lineWidth = (s.width || 1.5) + 2; c.stroke(); }
      path(); c.strokeStyle = paint(s.role); c.lineWidth = s.width || 1.5; c.setLineDash(s.dash || []); c.stroke(); c.setLineDash([]);
    }
    /* Uniform samples: per pixel column from least to largest, so that no peak is lost. */
    line(s) {
      const { context: c, spec } = this, [x0, x1] = this.x, [first, last] = this.visible(s, x0, x1);
      c.strokeStyle = paint(s.role); c.lineWidth = s.width || 1.2; c.lineJoin = "round"; c.setLineDash(s.dash || []);
      c.beginPath();
      const columns = Math.max(1, Math.round(this.box.right - this.box.left)), per = (last - first) / columns;
      let on = false;
      if (per <= 2) {
        for (let i = first; i < last; i++) {
          const good = isFinite(s.y[i]), p = this.px(spec.start + spec.step * i);
          if (good) { if (on) c.lineTo(p, this.py(s.y[i])); else c.moveTo(p, this.py(s.y[i])); }
          on = good;
        }
      } else {
        for (let k = 0; k < columns; k++) {
          let low = Infinity, high = -Infinity, entry = NaN, exit = NaN;
          const a = Math.floor(first + k * per), b = Math.min(last, Math.floor(first + (k + 1) * per) + 1);
          for (let i = a; i < b; i++) {
            const v = s.y[i];
            if (!isFinite(v)) continue;
            if (!isFinite(entry)) entry = v;
            exit = v; if (v < low) low = v; if (v > high) high = v;
          }
          if (!isFinite(entry)) { on = false; continue; }
          const p = this.px(spec.start + spec.step * (a + b - 1) / 2);
          if (on) c.lineTo(p, this.py(entry)); else c.moveTo(p, this.py(entry));
          c.lineTo(p, this.py(low)); c.lineTo(p, this.py(high)); c.lineTo(p, this.py(exit));
          on = true;
        }
      }
      c.stroke(); c.setLineDash([]);
    }
    overlay() {
      const { context: c, box, group } = this;
      if (this.drag && this.drag.zoom) {
        const { from, to } = this.drag;
        c.fillStyle = paint("held"); c.strokeStyle = paint("after");
        const l = Math.min(from.x, to.x), w = Math.abs(to.x - from.x);
        const t = this.drag.tall ? Math.min(from.y, to.y) : box.top, h = this.drag.tall ? Math.abs(to.y - from.y) : box.bottom - box.top;
        c.fillRect(l, t, w, h); c.strokeRect(l + 0.5, t + 0.5, w, h);
      }
      if (group.cursor !== null && !this.drag) {
        const p = box.left + (group.cursor - this.x[0]) / (this.x[1] - this.x[0]) * (box.right - box.left);
        if (p >= box.left && p <= box.right) {
          c.strokeStyle = paint("cursor"); c.lineWidth = 1; c.beginPath();
          c.moveTo(Math.round(p) + 0.5, box.top); c.lineTo(Math.round(p) + 0.5, box.bottom); c.stroke();
        }
      }
      this.readout();
    }
    readout() {
      if (!this.values) return;
      const cursor = this.group.cursor, { spec } = this;
      const step = (this.shown[1] - this.shown[0]) / 1000;
      for (const { s, node } of this.values) {
        let text = "";
        if (cursor !== null) {
          let at = -1;
          if (s.x) {
            let best = Infinity;
            for (let i = 0; i < s.x.length; i++) {
              const d = Math.abs(this.xScale(s.x[i]) - cursor);
              if (d < best) { best = d; at = i; }
            }
          } else at = Math.round((cursor - spec.start) / spec.step);
          if (at >= 0 && at < s.y.length && isFinite(s.y[at])) text = number(s.y[at], spec.yLog ? Math.abs(s.y[at]) / 100 : step) + " " + spec.unit;
        }
        node.textContent = text;
      }
      if (this.where)
        this.where.textContent = cursor === null ? "" : number(this.xBack(cursor), spec.xLog ? this.xBack(cursor) / 100 : (this.x[1] - this.x[0]) / 2000) + " " + spec.xUnit;
    }
    legend() {
      const node = this.canvas.closest(".plot").querySelector(".legend");
      if (!node) return;
      this.values = [];
      const { spec } = this;
      for (const s of spec.series.filter(s => !s.cloud)) {
        const button = document.createElement("button"), swatch = document.createElement("i"), value = document.createElement("output");
        const ink = `var(--${s.role})`;
        swatch.style.background = s.dash ? `repeating-linear-gradient(90deg, ${ink} 0 5px, transparent 5px 8px)` : ink;
        button.type = "button"; button.setAttribute("aria-pressed", "true"); button.title = "show or hide";
        button.append(swatch, s.label || s.name, value);
        button.addEventListener("click", () => {
          const off = !this.hidden.has(s.name);
          if (off) this.hidden.add(s.name); else this.hidden.delete(s.name);
          button.setAttribute("aria-pressed", String(!off));
          this.draw();
        });
        node.append(button);
        this.values.push({ s, node: value });
      }
      if ((spec.shaded || []).length) {
        const note = document.createElement("span"), swatch = document.createElement("i");
        swatch.className = "held"; note.append(swatch, spec.shadedName || "kept from the fit"); node.append(note);
      }
      this.where = document.createElement("output"); this.where.className = "where"; node.append(this.where);
      const reset = document.createElement("button");
      reset.type = "button"; reset.className = "reset"; reset.textContent = "show all";
      reset.addEventListener("click", () => this.reset());
      node.append(reset); this.resetButton = reset; reset.hidden = true;
    }
    refresh() {
      for (const plot of this.group.plots) {
        const all = !plot.y && Math.abs(this.x[0] - plot.full[0]) + Math.abs(this.x[1] - plot.full[1]) < 1e-9 * (plot.full[1] - plot.full[0]);
        if (plot.resetButton) plot.resetButton.hidden = all;
        plot.draw();
      }
    }
    reset() {
      this.group.x = this.full.slice();
      for (const plot of this.group.plots) plot.y = null;
      this.refresh();
    }
    set(low, high) {
      const [a, b] = this.full, whole = b - a;
      const width = clamp(high - low, whole * 1e-6, whole);
      const start = clamp(low, a, b - width);
      this.group.x = [start, start + width];
      this.refresh();
    }
    zoom(factor, centre) {
      const [a, b] = this.x;
      this.set(centre - (centre - a) * factor, centre + (b - centre) * factor);
    }
    at(event) {
      const r = this.canvas.getBoundingClientRect(), { box } = this;
      return { x: clamp(event.clientX - r.left, box.left, box.right), y: clamp(event.clientY - r.top, box.top, box.bottom) };
    }
    toX(p) { return this.x[0] + (p - this.box.left) / (this.box.right - this.box.left) * (this.x[1] - this.x[0]); }
    toY(p) { return this.shown[0] + (this.box.bottom - p) / (this.box.bottom - this.box.top) * (this.shown[1] - this.shown[0]); }

    listen() {
      const { canvas } = this;
      canvas.tabIndex = 0;
      canvas.addEventListener("pointerdown", e => {
        if (e.button !== 0) return;
        canvas.setPointerCapture(e.pointerId);
        const from = this.at(e);
        this.drag = { from, to: from, zoom: !e.shiftKey, start: this.x.slice() };
      });
      canvas.addEventListener("pointermove", e => {
        const p = this.at(e);
        if (!this.drag) { this.group.cursor = this.toX(p.x); for (const plot of this.group.plots) plot.draw(); return; }
        const { drag } = this;
        drag.to = p;
        if (drag.zoom) { drag.tall = Math.abs(p.y - drag.from.y) > 24 && this.group.plots.length === 1; this.draw(); }
        else {
          const shift = (p.x - drag.from.x) / (this.box.right - this.box.left) * (drag.start[1] - drag.start[0]);
          this.set(drag.start[0] - shift, drag.start[1] - shift);
        }
      });
      const end = () => {
        const { drag } = this;
        this.drag = null;
        if (!drag) return;
        if (drag.zoom && Math.abs(drag.to.x - drag.from.x) > 6) {
          const ends = [this.toX(drag.from.x), this.toX(drag.to.x)].sort((a, b) => a - b);
          if (drag.tall) this.y = [this.toY(drag.from.y), this.toY(drag.to.y)].sort((a, b) => a - b);
          this.set(...ends);
        } else this.refresh();
      };
      canvas.addEventListener("pointerup", end);
      canvas.addEventListener("pointercancel", () => { this.drag = null; this.draw(); });
      canvas.addEventListener("pointerleave", () => { this.group.cursor = null; for (const plot of this.group.plots) plot.draw(); });
      canvas.addEventListener("dblclick", () => this.reset());
      canvas.addEventListener("wheel", e => {
        if (document.activeElement !== canvas) return; /* the page scrolls on */
        e.preventDefault();
        this.zoom(e.deltaY > 0 ? 1.25 : 0.8, this.toX(this.at(e).x));
      }, { passive: false });
      canvas.addEventListener("keydown", e => {
        const [a, b] = this.x, w = b - a;
        if (e.key === "ArrowLeft") this.set(a - 0.1 * w, b - 0.1 * w);
        else if (e.key === "ArrowRight") this.set(a + 0.1 * w, b + 0.1 * w);
        else if (e.key === "+" || e.key === "=") this.zoom(0.7, (a + b) / 2);
        else if (e.key === "-") this.zoom(1 / 0.7, (a + b) / 2);
        else if (e.key === "0") this.reset();
        else return;
        e.preventDefault();
      });
    }
  }

  const groups = {}, plots = [];
  const grouped = name => groups[name] || (groups[name] = { x: null, plots: [], cursor: null });
  const decode = series => series.map(s => ({ ...s, y: s.packed ? unpack(s.packed) : list(s.y),
    x: s.packedX ? unpack(s.packedX) : s.x ? list(s.x) : null }));
  for (const canvas of document.querySelectorAll("canvas[data-plot]")) {
    const spec = data.plots[canvas.dataset.plot];
    plots.push(new Plot(canvas, { ...spec, series: decode(spec.series) }, grouped(spec.group || canvas.dataset.plot)));
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.forEach(plot => plot.draw()));

  for (const button of document.querySelectorAll("button[data-copy]"))
    button.addEventListener("click", async () => {
      const node = document.getElementById(button.dataset.copy), said = button.textContent;
      try { await navigator.clipboard.writeText(node.textContent); }
      catch { /* a page opened from a file may not use the clipboard: select, and copy the old way */
        const range = document.createRange(); range.selectNodeContents(node);
        const selection = getSelection(); selection.removeAllRanges(); selection.addRange(range);
        document.execCommand("copy");
      }
      button.textContent = "copied"; setTimeout(() => { button.textContent = said; }, 1500);
    });
})();
