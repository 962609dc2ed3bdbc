// Points of the page: one vertex for each, coloured by the column that somebody chose.

import * as THREE from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

const QUIET = [128, 138, 152]; // of points without a column
const EMPHASIS = 2.5; // width of an emphasised point over that of another, as in points.py
const SMALLEST = 1.6; // pixels
const LARGEST = 40;
const AXES = ["#d62828", "#22a050", "#2a6fdb"]; // x y z
const LINE_WIDTH = 2.5; // pixels

/**
 * Column that can colour the points: numbers as levels of 0 to 255 between two ends, one of a few
 * labels, or a colour for each point.
 * @typedef {object} Column
 * @property {string} name
 * @property {"scale" | "classes" | "colors"} kind
 * @property {string} values  base64: one byte for each point, for colours three
 * @property {string[]} [ends]  the numbers at both ends of the colour bar, written out
 * @property {string[]} [labels]
 * @property {number[][]} [palette]  r g b of each label
 * @property {number[]} [emphasis]  labels whose points are larger
 * @property {number[]} [counts]  points of each label
 */

/**
 * Points as Python writes them; lengths are those of the page, where the first model has size 1.
 * @typedef {object} Entry
 * @property {string} positions  base64, x y z of each point
 * @property {boolean} exact  float32; else 16 bits between `low` and `low + extent`
 * @property {number[]} low
 * @property {number[]} extent
 * @property {number[] | null} origin  where the sensor stood
 * @property {number} spread  a point's width over its distance from there
 * @property {number} least  a point's width at least
 * @property {Column[]} columns
 * @property {{name: string, color: string, ends: string, in_front: boolean}[]} lines  float32 in base64
 * @property {{place: number[], length: number, label: string}} axes
 */

const VERTEX = `
attribute vec4 tint; // r g b, and whether it is larger
uniform vec3 origin;
uniform float spread, least, scale, pixels, smallest, largest;
varying vec3 shade;
varying float width;
void main() {
  vec4 place = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * place;
  gl_Position = projectionMatrix * seen;
  float size = max(least, spread * distance(place.xyz, origin));
  float larger = 1.0 + tint.w * ${(EMPHASIS - 1).toFixed(2)};
  width = scale * larger * clamp(size * pixels / max(-seen.z, 1e-9), smallest, largest);
  gl_PointSize = width;
  shade = tint.rgb;
}`;

const FRAGMENT = `
varying vec3 shade;
varying float width;
void main() {
  vec2 off = 2.0 * gl_PointCoord - 1.0;
  if (width > 3.0 && dot(off, off) > 1.0) discard; // round, where one can see it
  gl_FragColor = vec4(shade, 1.0); // sRGB as it is
}`;

export class Cloud {
  /**
   * @param {Entry} entry
   * @param {(base64: string) => ArrayBuffer} decode
   * @param {number[][]} ramp  r g b from low to high
   */
  constructor(entry, decode, ramp) {
    this.columns = entry.columns;
    this.entry = entry;
    this.decode = decode;
    this.table = table(ramp);
    const positions = decode(entry.positions);
    const array = entry.exact ? new Float32Array(positions) : new Uint16Array(positions);
    this.count = array.length / 3;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(array, 3, !entry.exact));
    this.tint = new THREE.BufferAttribute(new Uint8Array(4 * this.count), 4, true);
    geometry.setAttribute("tint", this.tint);
    this.material = new THREE.ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        origin: { value: new THREE.Vector3().fromArray(entry.origin ?? [0, 0, 0]) },
        spread: { value: entry.origin ? entry.spread : 0 },
        least: { value: entry.least },
        scale: { value: 1 },
        pixels: { value: 1 },
        smallest: { value: SMALLEST },
        largest: { value: LARGEST },
      },
    });
    this.points = new THREE.Points(geometry, this.material);
    this.points.frustumCulled = false;
    if (!entry.exact) {
      this.points.position.fromArray(entry.low);
      this.points.scale.fromArray(entry.extent.map((side) => side || 1));
    }
    this.points.onBeforeRender = (renderer, _scene, camera) => this.#measure(renderer, camera);
    this.lines = new THREE.Group();
    for (const { color, ends, in_front } of entry.lines) {
      const lines = segments(new Float32Array(decode(ends)), { color, depthTest: !in_front });
      lines.renderOrder = Number(in_front);
      this.lines.add(lines);
    }
    this.axes = axes(entry.axes);
    this.root = new THREE.Group().add(this.points, this.lines, this.axes);
    this.share = 1;
    /** @type {number | undefined} */
    this.ratio = undefined; // pixels drawn per pixel kept, each way; the renderer's own without it
    this.colorBy(this.columns[0]?.name);
  }

  /** @param {THREE.WebGLRenderer} renderer @param {THREE.Camera} camera */
  #measure(renderer, camera) {
    const { uniforms } = this.material;
    const height = renderer.getCurrentViewport(new THREE.Vector4()).w;
    uniforms.pixels.value = (height / 2) * camera.projectionMatrix.elements[5];
    const ratio = this.ratio ?? renderer.getPixelRatio();
    uniforms.smallest.value = SMALLEST * ratio;
    uniforms.largest.value = LARGEST * ratio;
    this.material.uniformsNeedUpdate = true;
  }

  /** Draws a part of the points only, each one larger. @param {number} share in (0, 1] */
  thin(share) {
    this.share = share;
    this.points.geometry.setDrawRange(0, Math.ceil(share * this.count));
    this.#resize();
  }

  /** @param {import("./model.js").Looks} looks */
  show(looks) {
    this.axes.visible = looks.axes;
    this.lines.visible = looks.lines;
    this.scale = looks.size;
    this.#resize();
  }

  #resize() {
    this.material.uniforms.scale.value = (this.scale ?? 1) / Math.sqrt(this.share);
  }

  /** @param {string | undefined} name @returns {boolean} whether there is such a column */
  colorBy(name) {
    const column = this.columns.find((one) => one.name === name);
    if (name !== undefined && !column) return false;
    this.column = column;
    const tint = /** @type {Uint8Array} */ (this.tint.array);
    if (!column) fill(tint, () => QUIET, null);
    else {
      const values = new Uint8Array(this.decode(column.values));
      if (column.kind === "colors") {
        for (let i = 0, j = 0; j < values.length; i += 4, j += 3) {
          tint[i] = values[j];
          tint[i + 1] = values[j + 1];
          tint[i + 2] = values[j + 2];
          tint[i + 3] = 0;
        }
      } else {
        const colors = column.kind === "scale" ? this.table : column.palette ?? [];
        const larger = new Set(column.emphasis ?? []);
        fill(tint, (value) => colors[value], { values, larger });
      }
    }
    this.tint.needsUpdate = true;
    return true;
  }

  /** Some of the points, and the ends of all lines. @param {THREE.Matrix4} transform */
  vertices(transform) {
    const found = [];
    const { position } = this.points.geometry.attributes;
    const matrix = transform.clone().multiply(this.points.matrixWorld);
    const step = Math.max(1, Math.floor(this.count / 20000));
    for (let i = 0; i < this.count; i += step) {
      found.push(new THREE.Vector3().fromBufferAttribute(position, i).applyMatrix4(matrix));
    }
    for (const { ends } of this.entry.lines) {
      const array = new Float32Array(this.decode(ends));
      for (let i = 0; i < array.length; i += 3) {
        found.push(new THREE.Vector3().fromArray(array, i).applyMatrix4(transform));
      }
    }
    return found;
  }
}

/**
 * @param {Uint8Array} tint @param {(value: number) => number[]} color
 * @param {{values: Uint8Array, larger: Set<number>} | null} classes
 */
function fill(tint, color, classes) {
  const words = Array.from({ length: 256 }, (_, value) => {
    const [r, g, b] = color(value) ?? QUIET;
    return new Uint32Array(new Uint8Array([r, g, b, classes?.larger.has(value) ? 255 : 0]).buffer)[0];
  });
  const whole = new Uint32Array(tint.buffer);
  for (let i = 0; i < whole.length; i++) whole[i] = words[classes ? classes.values[i] : 0];
}

/** @param {number[][]} ramp @returns {number[][]} 256 colours */
function table(ramp) {
  return Array.from({ length: 256 }, (_, level) => {
    const at = (level / 255) * (ramp.length - 1);
    const below = Math.min(Math.floor(at), ramp.length - 2);
    return ramp[below].map((low, i) => Math.round(low + (at - below) * (ramp[below + 1][i] - low)));
  });
}

/** @param {Float32Array} ends @param {object} look */
function segments(ends, look) {
  const geometry = new LineSegmentsGeometry().setPositions(ends);
  const lines = new LineSegments2(geometry, new LineMaterial({ linewidth: LINE_WIDTH, ...look }));
  lines.frustumCulled = false;
  return lines;
}

/** @param {Entry["axes"]} settings */
function axes({ place, length }) {
  const group = new THREE.Group();
  AXES.forEach((color, axis) => {
    const end = [...place];
    end[axis] += length;
    group.add(segments(new Float32Array([...place, ...end]), { color }));
  });
  return group;
}

/**
 * The legend of the colours.
 * @param {Cloud} cloud @param {boolean} withAxes @param {boolean} withLines
 * @param {(tag: string, attributes?: Record<string, string>, ...children: (Node | string)[]) => HTMLElement} element
 */
export function legend(cloud, withAxes, withLines, element) {
  const rows = [];
  const { column } = cloud;
  const swatch = (/** @type {string} */ color) => element("i", { style: `background:${color}` });
  const css = (/** @type {number[]} */ color) => `rgb(${color.join(" ")})`;
  if (column?.kind === "scale") {
    const stops = cloud.table.filter((_, level) => level % 15 === 0).map(css).join(",");
    rows.push(
      element("div", {}, column.name),
      element("div", { class: "ramp", style: `background:linear-gradient(90deg,${stops})` }),
      element("div", { class: "ends" }, ...(column.ends ?? []).map((end) => element("span", {}, end))),
    );
  }
  column?.labels?.forEach((label, i) => {
    const points = (column.counts ?? [])[i].toLocaleString("en");
    rows.push(element("div", {}, swatch(css((column.palette ?? [])[i])), `${label} (${points})`));
  });
  if (withLines) {
    for (const { name, color } of cloud.entry.lines) {
      rows.push(element("div", { class: "line" }, swatch(color), name));
    }
  }
  if (withAxes) {
    // In shades of the axes' colours that can be read on either background.
    const letters = ["x", "y", "z"].map((letter) => element("b", { class: letter }, `${letter} `));
    rows.push(element("div", {}, ...letters, cloud.entry.axes.label));
  }
  return element("div", { class: "legend" }, ...rows);
}
