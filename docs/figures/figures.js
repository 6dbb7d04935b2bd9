// Figures one can move: no library, no network. Formulas are those of optics.js.
"use strict";

(() => {
  const SPACE = "http://www.w3.org/2000/svg";
  const COLOURS = ["one", "two", "three", "four", "five", "six", "seven", "eight"];

  const make = (name, facts = {}, text = "") => {
    const node = document.createElementNS(SPACE, name);
    for (const [key, value] of Object.entries(facts)) node.setAttribute(key, value);
    if (text) node.textContent = text;
    return node;
  };

  const line = (points, colour, width = 2) =>
    make("polyline", {
      points: points.map((p) => p.map((x) => x.toFixed(2)).join(",")).join(" "),
      fill: "none", stroke: `var(--${colour})`, "stroke-width": width, "stroke-linejoin": "round",
    });

  // A frame with axes; returns the drawing and what takes numbers to its places.
  function plot([left, right], [low, high], across, up, height = 300) {
    const box = { l: 52, t: 14, w: 560, h: height - 60 };
    const svg = make("svg", { viewBox: `0 0 640 ${height}`, role: "img" });
    const x = (v) => box.l + ((v - left) / (right - left)) * box.w;
    const y = (v) => box.t + (1 - (v - low) / (high - low)) * box.h;
    for (let i = 0; i <= 6; i++) {
      const h = left + ((right - left) * i) / 6, v = low + ((high - low) * i) / 6;
      svg.append(line([[x(h), y(low)], [x(h), y(high)]], "faint", 1));
      svg.append(line([[x(left), y(v)], [x(right), y(v)]], "faint", 1));
      svg.append(make("text", { x: x(h), y: y(low) + 16, "text-anchor": "middle" }, short(h)));
      svg.append(make("text", { x: x(left) - 6, y: y(v) + 4, "text-anchor": "end" }, short(v)));
    }
    svg.append(make("text", { x: x((left + right) / 2), y: height - 8, "text-anchor": "middle" }, across));
    svg.append(make("text", { x: x(right) - 6, y: y(high) + 16, "text-anchor": "end" }, up));
    return { svg, x, y };
  }

  const short = (v) => (Math.abs(v) < 1e-9 ? "0" : Number(v.toPrecision(3)).toString());

  // A slider with its name and value; `drawn` is called whenever it moves.
  function slider(row, name, [least, most, step, start], unit, drawn) {
    const label = document.createElement("label"), input = document.createElement("input");
    const output = document.createElement("output");
    Object.assign(input, { type: "range", min: least, max: most, step, value: start });
    const told = () => { output.textContent = `${Number(input.value)} ${unit}`; };
    input.addEventListener("input", () => { told(); drawn(); });
    told();
    label.append(name, input, output);
    row.append(label);
    return () => Number(input.value);
  }

  function parts(place) {
    const row = document.createElement("div"), held = document.createElement("div");
    const told = document.createElement("p");
    row.className = "controls";
    told.className = "told";
    place.replaceChildren(held, row, told);
    return { row, held, told };
  }

  // r(theta) of every lens, to where it turns back or ends.
  function lens(place) {
    const { row, held, told } = parts(place);
    const names = Object.keys(LENSES), chosen = new Set(names.slice(0, 5));
    const curve = (name) => {
      const points = [];
      for (let d = 0, last = -1; d <= 180; d += 0.5) {
        const r = radius(name, (d * Math.PI) / 180);
        if (!(r > last) || r > 3) break;
        points.push([d, (last = r)]);
      }
      return points;
    };
    const draw = () => {
      const { svg, x, y } = plot([0, 180], [0, 3], "theta, degrees from the axis", "r, focal lengths", 340);
      names.forEach((name, i) => {
        if (chosen.has(name)) svg.append(line(curve(name).map(([d, r]) => [x(d), y(r)]), COLOURS[i]));
      });
      const at = angle();
      svg.append(line([[x(at), y(0)], [x(at), y(3)]], "line", 1));
      const values = [...chosen].map((name) => [name, radius(name, (at * Math.PI) / 180)]);
      told.textContent = `At ${at} degrees: ` + values.map(([name, r]) =>
        `${name} ${Number.isFinite(r) && r >= 0 && r < 1e3 ? r.toFixed(3) : "none"}`).join(", ") + ".";
      held.replaceChildren(svg);
    };
    const angle = slider(row, "theta", [0, 180, 1, 60], "degrees", draw);
    names.forEach((name, i) => {
      const label = document.createElement("label"), box = document.createElement("input");
      Object.assign(box, { type: "checkbox", checked: chosen.has(name) });
      box.style.accentColor = `var(--${COLOURS[i]})`;
      label.style.color = `var(--${COLOURS[i]})`;
      box.addEventListener("change", () => { box.checked ? chosen.add(name) : chosen.delete(name); draw(); });
      label.append(box, name);
      row.append(label);
    });
    draw();
  }

  // Diameter of the blur over depth, under a thin lens.
  function aperture(place) {
    const { row, held, told } = parts(place);
    const draw = () => {
      const [opening, focus, focal, depth] = [R(), f(), F(), z()];
      const { svg, x, y } = plot([0, 12], [0, 30], "depth, scene units", "circle of confusion, pixels");
      const points = [];
      for (let d = 0.1; d <= 12; d += 0.02) {
        const c = confusion(opening, focal, focus, d);
        if (c <= 30) points.push([x(d), y(c)]);
      }
      const c = confusion(opening, focal, focus, depth), shown = Math.min(c, 30);
      const far = confusion(opening, focal, focus, Infinity);
      svg.append(line([[x(0), y(Math.min(far, 30))], [x(12), y(Math.min(far, 30))]], "line", 1));
      svg.append(line([[x(focus), y(0)], [x(focus), y(30)]], "two", 1));
      svg.append(line(points, "one"));
      svg.append(make("circle", { cx: x(depth), cy: y(shown), r: 4, fill: "var(--five)" }));
      told.textContent = `A point at depth ${depth} becomes a disc of ${c.toFixed(2)} pixels, one at ` +
        `infinity one of ${far.toFixed(2)} (grey line). Sharp is ${focus} (upright line).`;
      held.replaceChildren(svg);
    };
    const R = slider(row, "radius", [0, 0.3, 0.01, 0.09], "units", draw);
    const f = slider(row, "focus_distance", [0.5, 9, 0.1, 2.5], "units", draw);
    const F = slider(row, "focal length", [20, 400, 5, 100], "pixels", draw);
    const z = slider(row, "depth", [0.3, 12, 0.1, 6], "units", draw);
    draw();
  }

  // A bar that moves to the right, as rows see it one after another.
  function shutter(place) {
    const { row, held, told } = parts(place);
    const rows = 48, wide = 20;
    const draw = () => {
      const [readout, exposure, speed] = [T(), e(), v()];
      const svg = make("svg", { viewBox: "0 0 640 270", role: "img" });
      const scale = 560 / 100, top = 10, high = 5;
      for (let i = 0; i < rows; i++) {
        const t = rowTime(readout, rows, i), half = (Math.abs(speed) * exposure) / 2;
        const middle = 50 + speed * t;
        // Light of the bar's edges: a ramp as wide as the way during the exposure.
        for (let s = 0; s < 100; s += 1) {
          const covered = (edge) => half ? Math.min(Math.max((s + 0.5 - edge + half) / (2 * half), 0), 1) : +(s + 0.5 >= edge);
          const light = covered(middle - wide / 2) - covered(middle + wide / 2);
          if (light > 0.004) {
            svg.append(make("rect", { x: 40 + s * scale, y: top + i * high, width: scale, height: high, "shape-rendering": "crispEdges",
              fill: "var(--one)", "fill-opacity": light.toFixed(3) }));
          }
        }
      }
      svg.append(make("rect", { x: 40, y: top, width: 560, height: rows * high, fill: "none", stroke: "var(--line)" }));
      svg.append(make("text", { x: 34, y: top + 10, "text-anchor": "end" }, "0"));
      svg.append(make("text", { x: 34, y: top + rows * high, "text-anchor": "end" }, String(rows - 1)));
      const first = rowTime(readout, rows, 0), last = rowTime(readout, rows, rows - 1);
      told.textContent = `The first row looks at ${first.toFixed(3)}, the last at ${last.toFixed(3)} from the ` +
        `frame's time: the bar leans by ${(speed * (last - first)).toFixed(1)} pixels, and its edges blur over ` +
        `${(Math.abs(speed) * exposure).toFixed(1)}.`;
      held.replaceChildren(svg);
    };
    const T = slider(row, "readout", [0, 0.5, 0.01, 0.25], "", draw);
    const e = slider(row, "exposure", [0, 0.3, 0.01, 0.05], "", draw);
    const v = slider(row, "speed", [-100, 100, 5, 80], "pixels a unit of time", draw);
    draw();
  }

  const kinds = { lens, aperture, shutter };
  document.querySelectorAll("[data-figure]").forEach((place) => {
    place.replaceChildren();  // the text for where this does not run
    kinds[place.dataset.figure](place);
  });
})();
