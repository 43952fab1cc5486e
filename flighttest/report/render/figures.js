"use strict";
// Draws every figure of the report; colours come from the page's palette so that light, dark and print all read well.
(function () {
  const light = {
    ink: "#24303c", grid: "#dfe5ea", measured: "#1f2937", simulated: "#f2a36b", reference: "#94a3b8", before: "#b45309", after: "#0f766e",
    model: "#c2410c", linearised: "#7c3aed", no_drag: "#0284c7", no_battery: "#15803d", only_delay: "#be185d", limit: "#b91c1c",
    band: "#cbd5e1", other: "#2563eb", heat: [[0, "#f6f8fa"], [0.25, "#fde2c4"], [0.6, "#f08a4b"], [1, "#8f1d1d"]],
  };
  const dark = {
    ink: "#d6dee6", grid: "#2b3641", measured: "#e5ebf1", simulated: "#b4612a", reference: "#64748b", before: "#f0b429", after: "#4fd1c5",
    model: "#ff9d5c", linearised: "#b79cff", no_drag: "#6cc4ff", no_battery: "#7bd88f", only_delay: "#ff8fc0", limit: "#ff7b7b",
    band: "#3b4856", other: "#7ea6ff", heat: [[0, "#17202a"], [0.25, "#4a2f22"], [0.6, "#c2622b"], [1, "#ffd2a6"]],
  };
  const wantsDark = window.matchMedia("(prefers-color-scheme: dark)");
  const store = document.documentElement;
  const palette = (printing) => {
    if (printing) return light;
    const forced = store.dataset.theme;
    return (forced ? forced === "dark" : wantsDark.matches) ? dark : light;
  };
  function paint(value, colours) {
    if (typeof value === "string") return value[0] === "@" && value.slice(1) in colours ? colours[value.slice(1)] : value;
    if (Array.isArray(value)) return value.length && typeof value[0] === "number" ? value : value.map((v) => paint(v, colours));
    if (value && typeof value === "object") {
      const out = {};
      for (const key in value) out[key] = key === "x" || key === "y" || key === "z" ? value[key] : paint(value[key], colours);
      return out;
    }
    return value;
  }
  window.pageColours = palette;
  window.paint = paint;
  window.repaint = [];  // what else is drawn anew when the palette changes
  const drawn = [];
  const buttons = (item) => {
    const box = document.createElement("span");
    box.className = "save";
    box.append("save ");
    const file = (index) => `${item.spec.id}${item.plots.length > 1 ? "-" + (index + 1) : ""}`;
    for (const kind of ["png", "svg", "csv"]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = kind.toUpperCase();
      button.title = kind === "csv" ? "the numbers of this picture" : "this picture as it is shown";
      button.addEventListener("click", async () => {
        if (kind === "csv") return saveText(`${item.spec.id}.csv`, csvOf(item.spec.panels));
        for (let i = 0; i < item.plots.length; i++) {
          const box = item.plots[i].getBoundingClientRect();
          await Plotly.downloadImage(item.plots[i], { format: kind, filename: file(i), width: box.width, height: box.height, scale: kind === "png" ? 2 : 1 });
        }
      });
      box.append(button);
    }
    return box;
  };
  const PAPER = 690, GAP = 14;  // CSS pixels: what A4 and Letter hold upright within their margins, and between two pictures
  window.printedWidth = (columns) => Math.floor((PAPER - GAP * (columns - 1)) / columns);
  function draw(printing) {
    const colours = palette(printing);
    for (const item of drawn) {
      if (!item.plots[0].offsetParent) continue;
      for (const chip of item.chips) chip.querySelector("i").style.borderColor = colours[chip.dataset.role] || colours.other;
      item.spec.panels.forEach((panel, index) => {
        const data = panel.data.map((t) => {
          const trace = paint(t, colours);
          if (item.hidden.has(t.legendgroup)) trace.visible = false;
          else if (trace.visible === "legendonly") trace.visible = true;
          return trace;
        });
        const size = printing ? { autosize: false, width: printedWidth(Math.min(item.spec.columns, item.spec.panels.length)) } : { autosize: true };
        const layout = Object.assign(paint(panel.layout, colours), size, { height: item.spec.height, font: { family: getComputedStyle(document.body).fontFamily, size: 11, color: colours.ink } });
        Plotly.react(item.plots[index], data, layout, { displayModeBar: false, responsive: true });
      });
    }
  }
  function prepare(figure, spec) {
    const hidden = new Set(spec.legend.filter((e) => !e.shown).map((e) => e.name));
    const bar = figure.querySelector(".legend"), place = figure.querySelector(".plots");
    for (const _ of spec.panels) {
      const plot = document.createElement("div");
      plot.className = "plot";
      plot.style.minHeight = `${spec.height}px`;
      place.append(plot);
    }
    const chips = spec.legend.map((entry) => {
      const chip = document.createElement("button");
      chip.type = "button";
      chip.dataset.role = entry.role;
      chip.setAttribute("aria-pressed", String(!hidden.has(entry.name)));
      const swatch = document.createElement("i");
      swatch.style.borderTopStyle = { solid: "solid", dot: "dotted" }[entry.dash] || "dashed";
      chip.append(swatch, entry.name);
      chip.addEventListener("click", () => {
        if (hidden.has(entry.name)) hidden.delete(entry.name); else hidden.add(entry.name);
        chip.setAttribute("aria-pressed", String(!hidden.has(entry.name)));
        draw(false);
      });
      bar.append(chip);
      return chip;
    });
    const item = { spec, hidden, chips, plots: Array.from(figure.querySelectorAll(".plot")) };
    bar.append(buttons(item));
    drawn.push(item);
  }
  const everything = (printing) => {
    draw(printing);
    for (const again of window.repaint) again(printing);
  };
  function revive(specs, data) {
    const column = (v) => {
      if (!v || typeof v !== "object" || Array.isArray(v) || !("at" in v)) return v;
      if (!("low" in v)) return Array.from(new Float32Array(data.buffer, data.byteOffset + v.at, v.n), (x) => (Number.isNaN(x) ? null : x));
      return Array.from(new Int16Array(data.buffer, data.byteOffset + v.at, v.n), (c) => (c === -32768 ? null : v.low + (c + 32500) * v.step));
    };
    for (const spec of specs) for (const panel of spec.panels) for (const trace of panel.data) for (const axis of ["x", "y", "z"]) trace[axis] = column(trace[axis]);
    return specs;
  }
  Promise.all([window.unpack("packed-figures"), window.unpack("packed-figures-data"), window.plotlyReady]).then(([bytes, data]) => {
    const specs = revive(JSON.parse(new TextDecoder().decode(bytes)), data);
    document.querySelectorAll("figure[data-figure]").forEach((figure, index) => prepare(figure, specs[index]));
    everything(false);
    document.body.dataset.drawn = "yes";
    wantsDark.addEventListener("change", () => everything(false));
    const closed = [];  // lists that are folded on a screen are printed whole
    window.addEventListener("beforeprint", () => document.querySelectorAll("details:not([open])").forEach((one) => { one.open = true; closed.push(one); }));
    window.addEventListener("afterprint", () => closed.splice(0).forEach((one) => (one.open = false)));
    window.addEventListener("beforeprint", () => everything(true));
    window.addEventListener("afterprint", () => everything(false));
    for (const choice of document.querySelectorAll(".choice")) {
      const list = choice.querySelector("select"), shown = Array.from(choice.querySelectorAll(":scope > div"));
      list.addEventListener("change", () => {
        shown.forEach((one, index) => (one.hidden = index !== list.selectedIndex));
        draw(false);
      });
    }
  });
  const toggle = document.getElementById("theme");
  if (toggle) toggle.addEventListener("click", () => {
    const now = store.dataset.theme ? store.dataset.theme === "dark" : wantsDark.matches;
    store.dataset.theme = now ? "light" : "dark";
    everything(false);
  });
})();
