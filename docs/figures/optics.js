// The formulas behind the figures: those of gaussray/camera, for one number at a time.
// tests/test_figures.py compares them with the library's.
"use strict";

// How far from the middle, in focal lengths, light falls that comes `theta` off the axis.
const LENSES = {
  pinhole: { most: 89, radius: (theta) => Math.tan(theta) },
  equidistant: { most: 180, radius: (theta) => theta },
  equisolid: { most: 180, radius: (theta) => 2 * Math.sin(theta / 2) },
  stereographic: { most: 178.2, radius: (theta) => 2 * Math.tan(theta / 2) },
  orthographic: { most: 90, radius: (theta) => Math.sin(theta) },
  kannala_brandt: {
    most: 180,
    k: [-0.02, 0, 0, 0],
    radius: (theta, k) => {
      const s = theta * theta;
      return theta * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
    },
  },
  unified_sphere: {
    most: 180,
    k: [0.6, 1],
    radius: (theta, [alpha, beta]) => {
      const x = Math.sin(theta), z = Math.cos(theta);
      return x / (alpha * Math.sqrt(beta * x * x + z * z) + (1 - alpha) * z);
    },
  },
  double_sphere: {
    most: 180,
    k: [-0.2, 0.6],
    radius: (theta, [xi, alpha]) => {
      const x = Math.sin(theta), z = xi + Math.cos(theta);
      return x / (alpha * Math.sqrt(x * x + z * z) + (1 - alpha) * z);
    },
  },
};

// r(theta) of a lens by its name; NaN beyond what it can see.
function radius(name, theta) {
  const lens = LENSES[name];
  return theta <= (lens.most * Math.PI) / 180 ? lens.radius(theta, lens.k) : NaN;
}

// Diameter, in pixels, of the image of a point at depth z: 2 R F |1/f - 1/z|.
function confusion(opening, focal, focus, z) {
  return 2 * opening * focal * Math.abs(1 / focus - 1 / z);
}

// When row i of `rows` looks, from the frame's time, read evenly around it.
function rowTime(readout, rows, i) {
  return -readout / 2 + (readout / Math.max(rows - 1, 1)) * i;
}

if (typeof module !== "undefined") module.exports = { LENSES, radius, confusion, rowTime };
