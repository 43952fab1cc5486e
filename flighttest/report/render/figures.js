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
  const drawn = [];
  function draw(printing) {
    const colours = palette(printing);
    for (const item of drawn) {
      for (const chip of item.chips) chip.querySelector("i").style.borderColor = colours[chip.dataset.role] || colours.other;
      item.spec.panels.forEach((panel, index) => {
        const data = panel.data.map((t) => {
          const trace = paint(t, colours);
          if (item.hidden.has(t.legendgroup)) trace.visible = false;
          else if (trace.visible === "legendonly") trace.visible = true;
          return trace;
        });
        const layout = Object.assign(paint(panel.layout, colours), { height: item.spec.height, font: { family: getComputedStyle(document.body).fontFamily, size: 11, color: colours.ink } });
        Plotly.react(item.plots[index], data, layout, { displayModeBar: false, responsive: true });
      });
    }
  }
  document.querySelectorAll("figure[data-spec]").forEach((figure) => {
    const spec = JSON.parse(document.getElementById(figure.dataset.spec).textContent);
    const hidden = new Set(spec.legend.filter((e) => !e.shown).map((e) => e.name));
    const bar = figure.querySelector(".legend");
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
    drawn.push({ spec, hidden, chips, plots: Array.from(figure.querySelectorAll(".plot")) });
  });
  draw(false);
  wantsDark.addEventListener("change", () => draw(false));
  window.addEventListener("beforeprint", () => draw(true));
  window.addEventListener("afterprint", () => draw(false));
  const toggle = document.getElementById("theme");
  if (toggle) toggle.addEventListener("click", () => {
    const now = store.dataset.theme ? store.dataset.theme === "dark" : wantsDark.matches;
    store.dataset.theme = now ? "light" : "dark";
    draw(false);
  });
})();
