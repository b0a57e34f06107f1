"use strict";
// Draws as often as the screen shows it, where there is no graphics card too.
//
// What rests is left as it is on meshcat's canvas; what moves is drawn on a second one over it, of
// coarser shapes that are one mesh a machine and, if that does not do, of fewer pixels. After a
// moment's rest all is drawn in full, and how long that took decides: with a graphics card the
// second canvas is never needed.
function Pace({ viewer, pane, moving, heavy }) {
  const { THREE } = MeshCat;
  const full = viewer.renderer;
  const STILL = 0, MOVES = 1, COARSE = 2, HEAVY = 3, THIN = 4; // layers of three.js
  // Milliseconds: all in full, from frame to frame, until all rests, until the view does
  const LONG = 30, SLOW = 24, REST = 250, TURNS = 120;
  const LEAST = 0.5, MOST_POINTS = 1500, MOST_TRIANGLES = 150;
  let quick = null; // the second renderer
  let machines = []; // what it draws
  let needed = false; // whether it draws what moves
  let ratio = 1; // its pixels, of the first one's
  let late = 0; // frames in a row
  let frames = 0; // in time, since the ratio changed
  let patience = 90; // until more pixels are tried
  let before = 0; // when the screen was last shown
  let last = -Infinity; // when something was drawn
  let owed = false; // whether something was drawn since all was weighed
  let under = ""; // the view in which the first canvas shows what rests
  let seen = ""; // the view of the last frame
  let turned = 0; // when that was another one
  let version = 0;

  const layer = (root, from, to) => root.traverse((one) => one.layers.mask === 1 << from && one.layers.set(to));
  moving.forEach((root) => layer(root, STILL, MOVES));
  heavy.forEach((root) => layer(root, STILL, HEAVY));
  viewer.scene.traverse((one) => one.isLight && one.layers.enableAll());

  // Shapes of few triangles, and clouds of few points, beside those in full

  function gathered({ attributes, index }) { // corners in one cell of a grid become their mean
    const { position } = attributes;
    const box = new THREE.Box3().setFromBufferAttribute(position);
    const side = box.getSize(new THREE.Vector3());
    const cell = Math.max(side.x, side.y, side.z) / 10 || 1;
    const cells = new Map();
    const at = new THREE.Vector3();
    const own = Array.from({ length: index ? index.count : position.count }, (_, i) => {
      at.fromBufferAttribute(position, index ? index.getX(i) : i);
      const key = at.clone().sub(box.min).divideScalar(cell).floor().toArray().join();
      if (!cells.has(key)) cells.set(key, { sum: new THREE.Vector3(), count: 0 });
      const found = cells.get(key);
      found.sum.add(at);
      found.count += 1;
      return found;
    });
    const corners = [];
    const taken = new Set();
    for (let i = 0; i < own.length; i += 3) {
      const three = own.slice(i, i + 3);
      const key = three.map((one) => one.sum.toArray().join()).sort().join(";");
      if (new Set(three).size < 3 || taken.has(key)) continue;
      taken.add(key);
      three.forEach(({ sum, count }) => corners.push(sum.clone().divideScalar(count)));
    }
    const made = new THREE.BufferGeometry().setFromPoints(corners);
    made.computeVertexNormals();
    return made;
  }

  function coarse(geometry) {
    const { type, parameters: own, index, attributes } = geometry;
    if (type.startsWith("Sphere")) return new THREE.SphereGeometry(own.radius, 8, 6);
    if (type.startsWith("Cylinder")) return new THREE.CylinderGeometry(own.radiusTop, own.radiusBottom, own.height, 8);
    return (index || attributes.position).count > 3 * MOST_TRIANGLES ? gathered(geometry) : geometry;
  }

  // All meshes below a node as one, in the world's axes: a call for each costs more than its triangles
  class Merged {
    constructor(root) {
      this.root = root;
      this.coarse = new Map();
      let [corners, triangles, material] = [0, 0, null];
      root.traverse((one) => {
        if (!one.isMesh) return;
        if (!this.coarse.has(one.geometry)) this.coarse.set(one.geometry, coarse(one.geometry));
        const own = this.coarse.get(one.geometry);
        corners += own.attributes.position.count;
        triangles += (own.index || own.attributes.position).count;
        material = material || one.material;
      });
      if (!material) return;
      const values = (size) => new THREE.BufferAttribute(new Float32Array(size * corners), size);
      const geometry = new THREE.BufferGeometry();
      for (const name of ["position", "normal", "color"]) geometry.setAttribute(name, values(3));
      geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(triangles), 1));
      const own = material.clone();
      own.vertexColors = true;
      own.side = THREE.FrontSide; // backs would be lit and filled too
      own.color.set(0xffffff);
      this.mesh = new THREE.Mesh(geometry, own);
      this.mesh.frustumCulled = this.mesh.matrixAutoUpdate = false;
      this.mesh.matrix.copy(viewer.scene.matrixWorld).invert();
      this.mesh.layers.set(COARSE);
      viewer.scene.add(this.mesh);
    }

    follow() {
      if (!this.mesh) return;
      const { geometry } = this.mesh;
      const { position, normal, color } = geometry.attributes;
      let [corner, end] = [0, 0];
      this.root.traverseVisible((one) => {
        if (!one.isMesh) return;
        const own = this.coarse.get(one.geometry);
        const m = one.matrixWorld.elements;
        const p = own.attributes.position.array;
        const n = own.attributes.normal.array;
        const tint = one.material.color.clone();
        if (one.material.emissive) tint.add(one.material.emissive);
        const count = own.attributes.position.count;
        for (let i = 0, k = 3 * corner; i < 3 * count; i += 3, k += 3) {
          for (let row = 0; row < 3; row++) {
            position.array[k + row] = m[row] * p[i] + m[row + 4] * p[i + 1] + m[row + 8] * p[i + 2] + m[row + 12];
            normal.array[k + row] = m[row] * n[i] + m[row + 4] * n[i + 1] + m[row + 8] * n[i + 2];
          }
          [color.array[k], color.array[k + 1], color.array[k + 2]] = [tint.r, tint.g, tint.b];
        }
        const total = (own.index || own.attributes.position).count;
        for (let i = 0; i < total; i++) geometry.index.array[end + i] = corner + (own.index ? own.index.array[i] : i);
        corner += count;
        end += total;
      });
      geometry.setDrawRange(0, end);
      [position, normal, color, geometry.index].forEach((one) => (one.needsUpdate = true));
    }
  }

  function second() {
    viewer.scene.updateMatrixWorld();
    machines = moving.map((root) => new Merged(root));
    moving.forEach((root) => root.traverse((one) => one.isLine && one.layers.enable(COARSE)));
    const clouds = [];
    heavy.forEach((root) => root.traverse((one) => one.isPoints && clouds.push(one)));
    for (const one of clouds) { // points come in no order: the first are an even sample
      const some = new THREE.BufferGeometry();
      Object.entries(one.geometry.attributes).forEach(([name, values]) => some.setAttribute(name, values));
      some.setDrawRange(0, MOST_POINTS);
      const thin = new THREE.Points(some, one.material);
      thin.layers.set(THIN);
      one.add(thin);
    }
    quick = new THREE.WebGLRenderer({ antialias: false, alpha: true });
    quick.setClearColor(0x000000, 0);
    Object.assign(quick.domElement.style, { position: "absolute", left: 0, top: 0, pointerEvents: "none" });
    full.domElement.after(quick.domElement);
  }

  function picture(renderer, layers, ground) {
    const { background } = viewer.scene;
    viewer.camera.layers.mask = layers.reduce((sum, one) => sum | (1 << one), 0);
    if (!ground) viewer.scene.background = null;
    renderer.render(viewer.scene, viewer.camera);
    viewer.scene.background = background;
    viewer.camera.layers.mask = -1;
  }

  function whole() {
    picture(full, [STILL, MOVES, HEAVY], true);
    if (quick) quick.domElement.style.visibility = "hidden";
    under = "";
  }

  function swift() {
    if (!quick) second();
    const { clientWidth: width, clientHeight: height } = pane;
    const size = quick.getSize(new THREE.Vector2());
    const pixels = ratio * full.getPixelRatio();
    if (quick.getPixelRatio() !== pixels) quick.setPixelRatio(pixels);
    if (size.x !== width || size.y !== height) quick.setSize(width, height);
    viewer.scene.updateMatrixWorld();
    machines.forEach((one) => one.follow());
    if (seen !== under && last - turned > TURNS) {
      picture(full, [STILL, HEAVY], true);
      under = seen;
    }
    picture(quick, seen === under ? [COARSE] : [STILL, COARSE, THIN], seen !== under);
    quick.domElement.style.visibility = "visible";
  }

  function weigh() { // all in full, and whether that is too dear for motion
    const begin = performance.now();
    whole();
    const gl = full.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits until it is drawn
    decide(performance.now() - begin > LONG);
    owed = false;
  }

  function decide(dear) {
    needed = dear;
    late = frames = 0;
  }

  function judge(took) { // from a frame that was drawn to the next
    late = took > (needed ? SLOW : 4 * SLOW) ? late + 1 : 0;
    frames = late ? 0 : frames + 1;
    if (late >= 3 && !needed) weigh();
    else if (late >= 3) {
      ratio = Math.max(LEAST, 0.8 * ratio);
      patience = Math.min(2 * patience, 5000);
      late = frames = 0;
    } else if (frames > patience && ratio < 1) {
      ratio = Math.min(1, ratio / 0.8);
      frames = 0;
    }
  }

  function draw() {
    last = performance.now();
    owed = true;
    viewer.camera.updateMatrixWorld();
    const view = [version, pane.clientWidth, pane.clientHeight, ...viewer.camera.matrixWorld.elements, ...viewer.camera.projectionMatrix.elements].join();
    if (view !== seen) turned = last;
    seen = view;
    if (needed) swift();
    else whole();
  }

  function watch(now) {
    if (last >= before) judge(now - before);
    if (owed && performance.now() - last > REST) weigh();
    before = now;
    requestAnimationFrame(watch);
  }
  requestAnimationFrame(watch);

  return { draw, decide, changed: () => (version += 1), state: () => ({ needed, ratio, owed, quick }) };
}
