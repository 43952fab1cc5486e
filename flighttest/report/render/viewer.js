"use strict";
// Channels of a recording over one time axis: chosen by name, zoomed together, drawn with the detail that the window can show.
(function () {
  const POINTS = 1600, HEIGHT = 190, COLOURS = ["other", "model", "no_battery", "linearised", "only_delay", "after"];
  const MODE_COLOURS = ["#2563eb", "#15803d", "#c2410c", "#7c3aed", "#be185d", "#0f766e"];
  function decode(about, bytes) {
    const found = new Map();
    for (const one of about.series) {
      const deltas = new Uint32Array(bytes.buffer, bytes.byteOffset + one.t, one.n), t = new Float64Array(one.n);
      let ticks = 0;
      for (let i = 0; i < one.n; i++) t[i] = one.t0 + (ticks += deltas[i]) * 1e-5;
      for (const c of one.channels) {
        const coded = new Int16Array(bytes.buffer, bytes.byteOffset + c.at, one.n), y = new Float64Array(one.n);
        for (let i = 0; i < one.n; i++) y[i] = coded[i] === -32768 ? NaN : c.low + (coded[i] + 32500) * c.step;
        found.set(c.name, { t, y, group: one.group });
      }
    }
    return found;
  }
  const below = (t, at) => { let a = 0, b = t.length; while (a < b) { const m = (a + b) >> 1; if (t[m] < at) a = m + 1; else b = m; } return a; };
  function windowed(channel, from, to) {
    const a = Math.max(below(channel.t, from) - 1, 0), b = Math.min(below(channel.t, to) + 1, channel.t.length);
    const every = Math.max(1, Math.floor((2 * (b - a)) / POINTS)), x = [], y = [];
    for (let i = a; i < b;) {
      let low = -1, high = -1, k = i;
      for (; k < Math.min(i + every, b) && !Number.isNaN(channel.y[k]); k++) {
        if (low < 0 || channel.y[k] < channel.y[low]) low = k;
        if (high < 0 || channel.y[k] > channel.y[high]) high = k;
      }
      if (low >= 0) for (const j of low === high ? [low] : low < high ? [low, high] : [high, low]) { x.push(channel.t[j]); y.push(channel.y[j]); }
      if (k < b && Number.isNaN(channel.y[k])) {  // the line breaks where nothing was recorded
        x.push(channel.t[k]);
        y.push(null);
        while (k < b && Number.isNaN(channel.y[k])) k++;
      }
      i = k;
    }
    return { x, y };
  }
  async function start(box) {
    const key = box.dataset.viewer, text = new TextDecoder();
    const [about, data] = await Promise.all([window.unpack(`${key}-about`), window.unpack(`${key}-data`), window.plotlyReady]);
    const words = JSON.parse(text.decode(about)), channels = decode(words, data), shown = new Set(words.shown.filter((n) => channels.has(n)));
    const all = [...channels.values()], whole = [Math.min(...all.map((c) => c.t[0])), Math.max(...all.map((c) => c.t[c.t.length - 1]))];
    let range = whole.slice(), strips = [], busy = false, onPaper = false;
    const chips = box.querySelector(".channels"), place = box.querySelector(".strips");
    const modes = [...new Set(words.marks.filter((m) => m[3] === "mode").map((m) => m[2]))];
    for (const group of [...new Set(all.map((c) => c.group))]) {
      const title = document.createElement("b");
      title.textContent = group.replaceAll("_", " ");
      chips.append(title);
      for (const [name, channel] of channels) {
        if (channel.group !== group) continue;
        const chip = document.createElement("button");
        chip.type = "button";
        chip.textContent = words.words[name][0];
        chip.title = name;
        chip.setAttribute("aria-pressed", String(shown.has(name)));
        chip.addEventListener("click", () => {
          if (shown.has(name)) shown.delete(name); else shown.add(name);
          chip.setAttribute("aria-pressed", String(shown.has(name)));
          build();
        });
        chips.append(chip);
      }
    }
    const save = document.createElement("span");
    save.className = "save";
    for (const [label, action] of [
      ["whole flight", () => zoom(whole)],
      ["PNG", () => image("png")],
      ["SVG", () => image("svg")],
      ["CSV", () => saveText(`${key}.csv`, csvOf(strips.map((s) => ({ title: s.unit, data: traces(s, false) }))))],
    ]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = label;
      button.addEventListener("click", action);
      save.append(button, " ");
    }
    chips.append(save);
    async function image(format) {
      for (let i = 0; i < strips.length; i++) {
        const at = strips[i].plot.getBoundingClientRect();
        await Plotly.downloadImage(strips[i].plot, { format, filename: `${key}-${i + 1}`, width: at.width, height: at.height, scale: format === "png" ? 2 : 1 });
      }
    }
    const colours = () => window.pageColours(onPaper);
    function traces(strip, paintIt = true) {
      return strip.names.map((name, i) => {
        const [label, unit, held] = words.words[name], cut = windowed(channels.get(name), range[0], range[1]);
        const line = { width: held ? 1.2 : 1.1, shape: held ? "hv" : "linear", dash: held ? "dot" : "solid" };
        if (paintIt) line.color = colours()[COLOURS[i % COLOURS.length]];
        return { type: "scatter", mode: "lines", ...cut, name: label, line, hovertemplate: `<b>${label}</b> %{y:.4g}${unit === "1" ? "" : ` ${unit}`}<br>t %{x:.2f} s<extra></extra>` };
      });
    }
    function layout(strip, last, first) {
      const c = colours(), axis = { gridcolor: c.grid, linecolor: c.grid, zerolinecolor: c.grid };
      const shapes = words.marks.filter((m) => m[3] === "mode").map((m) => ({
        type: "rect", yref: "paper", y0: 0, y1: 1, x0: m[0], x1: m[1], layer: "below", line: { width: 0 }, opacity: 0.07,
        fillcolor: MODE_COLOURS[modes.indexOf(m[2]) % MODE_COLOURS.length],
      }));
      for (const m of words.marks) if (m[3] !== "mode") shapes.push({ type: "line", yref: "paper", y0: 0, y1: 1, x0: m[0], x1: m[0], layer: "below", line: { width: 0.7, dash: "dot", color: c.reference } });
      return {
        annotations: first ? labels(c) : [],
        height: HEIGHT + (last ? 26 : 0) + (first ? 24 : 0), margin: { l: 58, r: 10, t: first ? 46 : 22, b: last ? 40 : 14 }, showlegend: true, hovermode: "closest", dragmode: "zoom",
        legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yanchor: "bottom", font: { size: 11 } }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
        font: { family: getComputedStyle(document.body).fontFamily, size: 11, color: c.ink }, shapes,
        xaxis: { ...axis, range: range.slice(), showticklabels: last, title: last ? { text: "time, s", standoff: 4 } : undefined },
        yaxis: { ...axis, title: { text: strip.unit, standoff: 4 }, fixedrange: false },
      };
    }
    // Names of modes above the first strip, where there is room for them: 7 px a letter.
    const wide = () => Math.max((onPaper ? window.printedWidth(1) : place.clientWidth) - 68, 1);
    const labels = (c) => words.marks
      .map((m) => ({ ...m, from: Math.max(m[0], range[0]), to: Math.min(m[1], range[1]) }))
      .filter((m) => m[3] === "mode" && m.to - m.from > (7 * m[2].length / wide()) * (range[1] - range[0]))
      .map((m) => ({ x: m.from, y: 1.3, xref: "x", yref: "paper", xanchor: "left", showarrow: false, text: m[2], font: { size: 11, color: c.reference } }));
    function draw(printing = false) {
      onPaper = printing;
      const size = printing ? { autosize: false, width: window.printedWidth(1) } : { autosize: true };
      strips.forEach((s, i) => Plotly.react(s.plot, traces(s), { ...layout(s, i === strips.length - 1, i === 0), ...size }, { displayModeBar: false, responsive: true }));
    }
    function zoom(to) {
      range = [Math.max(to[0], whole[0]), Math.min(to[1], whole[1])];
      busy = true;
      draw();
      busy = false;
    }
    function build() {
      const units = new Map();
      for (const name of channels.keys()) {
        if (!shown.has(name)) continue;
        const [label, unit, , strip] = words.words[name];
        if (!units.has(strip)) units.set(strip, { unit: unit === "1" ? label : unit, names: [] });
        units.get(strip).names.push(name);
      }
      place.replaceChildren();
      strips = [...units.values()].map((strip) => {
        const plot = document.createElement("div");
        plot.className = "strip plot";
        place.append(plot);
        return { ...strip, plot };
      });
      draw();
      for (const strip of strips) strip.plot.on("plotly_relayout", (change) => {
        if (busy) return;
        if ("xaxis.range[0]" in change) zoom([change["xaxis.range[0]"], change["xaxis.range[1]"]]);
        else if (change["xaxis.autorange"]) zoom(whole);
      });
    }
    build();
    window.repaint.push(draw);
    box.dataset.drawn = "yes";
  }
  document.querySelectorAll(".viewer").forEach(start);
})();
