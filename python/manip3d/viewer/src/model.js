// A mesh of the page: its surfaces as loaded from GLB, and the lines drawn over them.

import * as THREE from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const CLAY = "#c3c8ce";
const EDGE_COLOR = "#101722";
const BOUNDARY_COLOR = "#e6193c";

/**
 * Switches of the toolbar.
 * @typedef {object} Looks
 * @property {boolean} texture  materials, textures and vertex colours; otherwise grey
 * @property {boolean} flat  one shade for each triangle
 * @property {boolean} wireframe
 * @property {boolean} boundary  edges that exactly one face uses
 * @property {boolean} backfaces  faces seen from behind
 * @property {boolean} axes  of points: the coordinate axes at the sensor
 * @property {boolean} lines  of points: boxes and bones
 * @property {number} size  of points, times as wide as usual
 */

export class Model {
  /**
   * @param {ArrayBuffer} glb
   * @param {Float32Array} boundary  x y z of both ends of each boundary edge
   */
  static async load(glb, boundary) {
    if (!glb.byteLength) return new Model(new THREE.Group(), boundary); // a mesh without faces
    const gltf = await new GLTFLoader().parseAsync(glb, "");
    return new Model(gltf.scene, boundary);
  }

  /** @param {THREE.Group} group @param {Float32Array} boundary */
  constructor(group, boundary) {
    /** @type {THREE.Mesh[]} */
    this.surfaces = [];
    group.traverse((node) => {
      if (node instanceof THREE.Mesh) this.surfaces.push(node);
    });
    for (const surface of this.surfaces) {
      surface.userData.materials = [
        new THREE.MeshStandardMaterial({ color: CLAY, roughness: 0.8, side: THREE.DoubleSide }),
        surface.material,
      ];
      for (const material of surface.userData.materials) {
        material.userData.side = material.side;
        material.polygonOffset = true; // lines on the surface stay in front of it
        material.polygonOffsetFactor = material.polygonOffsetUnits = 1;
      }
    }
    this.edges = new THREE.Group();
    this.boundary = new LineSegments2(
      new LineSegmentsGeometry().setPositions(boundary),
      new LineMaterial({ color: BOUNDARY_COLOR, linewidth: 1.5 }), // pixels
    );
    this.root = new THREE.Group().add(group, this.edges, this.boundary);
  }

  /** @param {Looks} looks */
  show(looks) {
    for (const surface of this.surfaces) {
      const material = surface.userData.materials[Number(looks.texture)];
      material.flatShading = looks.flat || !surface.geometry.attributes.normal;
      material.side = looks.backfaces ? material.userData.side : THREE.FrontSide;
      material.needsUpdate = true;
      surface.material = material;
    }
    if (looks.wireframe && !this.edges.children.length) this.#addEdges();
    this.edges.visible = looks.wireframe;
    this.boundary.visible = looks.boundary;
  }

  /** @param {THREE.Matrix4} transform */
  vertices(transform) {
    const found = [];
    for (const { geometry, matrixWorld } of this.surfaces) {
      const { position } = geometry.attributes;
      const matrix = transform.clone().multiply(matrixWorld);
      for (let i = 0; i < position.count; i++) {
        found.push(new THREE.Vector3().fromBufferAttribute(position, i).applyMatrix4(matrix));
      }
    }
    return found;
  }

  #addEdges() {
    const look = { wireframe: true, color: EDGE_COLOR, transparent: true, opacity: 0.4 };
    const material = new THREE.MeshBasicMaterial(look);
    for (const surface of this.surfaces) {
      surface.updateWorldMatrix(true, false);
      const lines = new THREE.Mesh(surface.geometry, material);
      lines.applyMatrix4(surface.matrixWorld);
      this.edges.add(lines);
    }
  }
}
