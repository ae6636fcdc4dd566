// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// Unpacks Bokeh and the plots that lie in the page; where a browser cannot, the pictures stay.
"use strict";

async function unpacked(id) {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

async function start() {
  const root = document.documentElement;
  if (!window.DecompressionStream || !document.getElementById("library")) return;
  const [library, text] = await Promise.all([unpacked("library"), unpacked("data")]);
  const script = document.createElement("script");
  script.textContent = library;
  document.head.append(script);
  const data = JSON.parse(text);
  Bokeh.set_log_level("warn");
  root.classList.add("interactive");
  try {
    await Bokeh.embed.embed_items(data.documents, data.items);
  } catch (error) {
    root.classList.remove("interactive");
    throw error;
  }
  for (const plot of Bokeh.documents[0].roots()) {
    // A finger on a plot scrolls the page; what it zooms is chosen in the toolbar.
    if (matchMedia("(pointer: coarse)").matches) plot.toolbar.active_drag = null;
  }
  const sources = [...Bokeh.documents[0].all_models].filter((model) => model.name === "lit");
  const buttons = [...document.querySelectorAll("button[data-light]")];
  window.trackresLight = (key) => {
    const cut = key === null ? -1 : key.lastIndexOf(":");
    const effect = key !== null && key.startsWith("effect:");
    const [of, letter] = key === null ? [null, ""] : effect ? [key, "0"] : [key.slice(0, cut), key.slice(cut + 1)];
    let seconds = 0;
    const counted = new Set();  // sessions
    for (const source of sources) {
      const [session, unit] = source.tags;
      const steps = data.steps[session];
      const letters = (of === null ? null : steps[of]) ?? "";
      const number = Number(letter);
      // On an edge a step is in two bins: "a" in 0 and 1, "b" in 1 and 2, and so on.
      const lit = new Set([letter, String.fromCharCode(97 + number), ...(number > 0 ? [String.fromCharCode(96 + number)] : [])]);
      const x0 = [], x1 = [];
      for (let i = 0; i < letters.length; i++) {
        if (!lit.has(letters[i])) continue;
        const first = i;
        while (lit.has(letters[i + 1])) i++;
        x0.push((steps.begin + steps.step * first) / unit);
        x1.push((steps.begin + steps.step * (i + 1)) / unit);
        if (!counted.has(session)) seconds += steps.step * (i + 1 - first);
      }
      counted.add(session);
      source.data = { x0, x1 };
    }
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.light === key));
    document.getElementById("lit").textContent = key === null ? "" : `${Math.round(seconds)} s are highlighted.`;
  };
  for (const button of buttons) {
    button.addEventListener("click", () => window.trackresLight(button.getAttribute("aria-pressed") === "true" ? null : button.dataset.light));
  }
  root.dataset.ready = "yes";
}

start();
