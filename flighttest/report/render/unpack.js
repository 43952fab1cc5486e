"use strict";
// Data that the page holds as text (base 85 of gzip, see packing.py), and plotly's own script among it.
window.unpack = async function (id) {
  const holder = document.getElementById(id), text = holder.textContent, size = Number(holder.dataset.bytes);
  const alphabet = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;<=>?@^_`{|}~";
  const value = new Uint8Array(128);
  for (let i = 0; i < 85; i++) value[alphabet.charCodeAt(i)] = i;
  const bytes = new Uint8Array((text.length / 5) * 4), view = new DataView(bytes.buffer);
  for (let i = 0, k = 0; i < text.length; i += 5, k += 4) {
    let word = 0;
    for (let j = 0; j < 5; j++) word = word * 85 + value[text.charCodeAt(i + j)];
    view.setUint32(k, word);
  }
  const stream = new Blob([bytes.subarray(0, size)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};
window.plotlyReady = window.unpack("packed-plotly").then((bytes) => {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(bytes);
  document.head.append(script);
});
window.plotlyReady.catch(() => {
  for (const plot of document.querySelectorAll(".plots, .strips")) plot.textContent = "Pictures need a browser of 2023 or newer (DecompressionStream).";
});
window.saveText = function (name, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
};
window.csvOf = function (panels) {
  const quote = (v) => (v === null || v === undefined ? "" : typeof v === "number" ? String(v) : `"${String(v).replaceAll('"', '""')}"`);
  const lines = ["panel,trace,x,y,z"];
  for (const panel of panels) for (const t of panel.data) {
    const flat = t.type !== "heatmap";
    for (let i = 0; i < t.x.length; i++) {
      if (flat) lines.push([panel.title, t.name, t.x[i], t.y[i], t.z ? t.z[i] : null].map(quote).join(","));
      else for (let j = 0; j < t.y.length; j++) lines.push([panel.title, t.name, t.x[i], t.y[j], t.z[j][i]].map(quote).join(","));
    }
  }
  return lines.join("\n") + "\n";
};
