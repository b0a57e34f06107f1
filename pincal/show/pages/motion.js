"use strict";
// Kinematics in the page: where links are at joint positions, and which joints close a pose.
// Matrices are rows of 4 x 4 in arrays of 16; joints of a leg are an array, moving ones alone.
const Motion = (() => {
  const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  function product(a, b) {
    const c = new Array(16);
    for (let i = 0; i < 16; i += 4) {
      for (let j = 0; j < 4; j++) c[i + j] = a[i] * b[j] + a[i + 1] * b[j + 4] + a[i + 2] * b[j + 8] + a[i + 3] * b[j + 12];
    }
    return c;
  }

  const turnedBy = (T, v) => [0, 4, 8].map((i) => T[i] * v[0] + T[i + 1] * v[1] + T[i + 2] * v[2]);
  const column = (T, j) => [T[j], T[j + 4], T[j + 8]];
  const origin = (T) => column(T, 3);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

  function rotation(axis, angle) { // Rodrigues; the axis has unit length
    const [x, y, z] = axis;
    const s = Math.sin(angle);
    const v = 1 - Math.cos(angle);
    return [
      1 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y, 0,
      v * x * y + s * z, 1 - v * (x * x + z * z), v * y * z - s * x, 0,
      v * x * z - s * y, v * y * z + s * x, 1 - v * (x * x + y * y), 0,
      0, 0, 0, 1,
    ];
  }

  function links(leg, q) {
    let T = IDENTITY;
    let next = 0;
    return leg.joints.map((joint) => {
      T = product(T, joint.T);
      if (joint.kind === "prismatic") {
        const shift = turnedBy(T, joint.axis.map((one) => one * q[next]));
        T = T.map((value, i) => (i % 4 === 3 && i < 12 ? value + shift[(i - 3) / 4] : value));
        next += 1;
      } else if (joint.kind !== "fixed") {
        T = product(T, rotation(joint.axis, q[next]));
        next += 1;
      }
      return T;
    });
  }

  function solved(A, b) { // Gauss with pivots; A is square, rows of arrays
    const n = b.length;
    for (let k = 0; k < n; k++) {
      let best = k;
      for (let i = k + 1; i < n; i++) if (Math.abs(A[i][k]) > Math.abs(A[best][k])) best = i;
      [A[k], A[best]] = [A[best], A[k]];
      [b[k], b[best]] = [b[best], b[k]];
      for (let i = k + 1; i < n; i++) {
        const factor = A[i][k] / A[k][k];
        for (let j = k; j < n; j++) A[i][j] -= factor * A[k][j];
        b[i] -= factor * b[k];
      }
    }
    for (let k = n - 1; k >= 0; k--) {
      for (let j = k + 1; j < n; j++) b[k] -= A[k][j] * b[j];
      b[k] /= A[k][k];
    }
    return b;
  }

  // How far a leg's tip is from a platform point, and by which joint it moves how; turns times a size
  function gap(leg, target, rows, q, size) {
    const frame = leg.closes === "frame";
    const every = links(leg, q);
    const tip = every[every.length - 1];
    const at = origin(tip);
    const wanted = origin(target);
    const missed = rows.map((row) => wanted[row] - at[row]);
    if (frame) { // half the sum of the axes' cross products: a small turn
      const turn = [0, 0, 0];
      for (let j = 0; j < 3; j++) cross(column(tip, j), column(target, j)).forEach((one, i) => (turn[i] += one / 2));
      missed.push(...turn.map((one) => one * size));
    }
    const columns = [];
    leg.joints.forEach((joint, place) => {
      if (joint.kind === "fixed") return;
      const axis = turnedBy(every[place], joint.axis);
      const sliding = joint.kind === "prismatic";
      const arm = origin(every[place]).map((one, i) => at[i] - one);
      const moved = sliding ? axis : cross(axis, arm);
      const own = rows.map((row) => moved[row]);
      if (frame) own.push(...axis.map((one) => (sliding ? 0 : one * size)));
      columns.push(own);
    });
    return { missed, columns };
  }

  function step(columns, missed) { // of least squares, damped; null if there is none
    const dot = (a, b) => a.reduce((sum, one, i) => sum + one * b[i], 0);
    const normal = columns.map((a) => columns.map((b) => dot(a, b)));
    normal.forEach((row, i) => (row[i] *= 1 + 1e-9));
    const found = solved(normal, columns.map((a) => dot(a, missed)));
    if (!found.every(Number.isFinite)) return null;
    const longest = Math.max(...found.map(Math.abs));
    return found.map((one) => one * Math.min(1, 0.5 / longest));
  }

  // Joints that bring a leg's tip to a platform point, by Gauss-Newton; null if out of reach
  function close(leg, target, rows, start, size) {
    let q = [...start];
    for (let iteration = 0; iteration < 30; iteration++) {
      const { missed, columns } = gap(leg, target, rows, q, size);
      if (Math.hypot(...missed) < 1e-9 * size) return q;
      const moved = step(columns, missed);
      if (!moved) return null;
      q = q.map((value, i) => value + moved[i]);
    }
    return null;
  }

  function displaced(T, twist) { // by a shift, and a turn about its origin
    const angle = Math.hypot(...twist.slice(3));
    const flat = T.map((one, i) => (i % 4 === 3 && i < 12 ? 0 : one));
    const turned = angle > 0 ? product(rotation(twist.slice(3).map((one) => one / angle), angle), flat) : flat;
    [turned[3], turned[7], turned[11]] = origin(T).map((one, i) => one + twist[i]);
    return turned;
  }

  // Joints of all legs, and the platform, of which the coordinates `free` follow from the others
  function together(motion, T, start) {
    const { legs, points, rows, size, free } = motion;
    let state = { T, joints: start };
    for (let iteration = 0; iteration < 30; iteration++) {
      const missed = [];
      const columns = free.map(() => []);
      legs.forEach((leg, place) => {
        const target = product(state.T, points[place]);
        const own = gap(leg, target, rows, state.joints[place], size);
        const arm = origin(target).map((one, i) => one - origin(state.T)[i]);
        free.forEach((row, k) => {
          const axis = [0, 1, 2].map((i) => +(i === row % 3));
          const moved = row < 3 ? axis : cross(axis, arm);
          columns[k].push(...rows.map((one) => -moved[one]));
          if (leg.closes === "frame") columns[k].push(...axis.map((one) => (row < 3 ? 0 : -size * one)));
        });
        own.columns.forEach((one) => columns.push([...missed.map(() => 0), ...one]));
        missed.push(...own.missed);
      });
      if (Math.hypot(...missed) < 1e-9 * size) return state;
      columns.forEach((one) => one.push(...missed.slice(one.length).map(() => 0)));
      const moved = step(columns, missed);
      if (!moved) return null;
      const twist = [0, 0, 0, 0, 0, 0];
      free.forEach((row, k) => (twist[row] = moved[k]));
      let next = free.length;
      state = { T: displaced(state.T, twist), joints: state.joints.map((own) => own.map((one) => one + moved[next++])) };
    }
    return null;
  }

  // Where a part is; chains: the links of all legs
  function placed(part, data, chains, joints, T) {
    if (part.on === "base") return IDENTITY;
    if (part.on === "platform") return part.leg < 0 ? T : product(T, data.points[part.leg]);
    const link = chains[part.leg][part.place];
    if (part.on === "link") return link;
    const leg = data.legs[part.leg];
    if (part.on === "parallel") {
      const x = turnedBy(link, leg.along);
      const y = turnedBy(chains[part.leg][part.place - 1], leg.joints[part.place - 1].axis);
      return framed(x, y, cross(x, y), origin(link));
    }
    const moving = leg.joints.slice(0, part.place).filter((joint) => joint.kind !== "fixed").length;
    const stroke = joints[part.leg][moving];
    const inside = part.inside * Math.sign(stroke);
    const rod = part.axis.map((one) => -(stroke - inside) * one);
    const own = part.on === "rod" ? rod : part.axis.map((one) => -inside * one);
    return product(link, framed(part.across, part.other, own, part.on === "rod" ? [0, 0, 0] : rod));
  }

  const framed = (x, y, z, p) => [x[0], y[0], z[0], p[0], x[1], y[1], z[1], p[1], x[2], y[2], z[2], p[2], 0, 0, 0, 1];

  function inverse(T) { // of a rigid transform
    const p = origin(T);
    const R = [0, 1, 2].map((j) => column(T, j));
    const back = R.map((axis) => -(axis[0] * p[0] + axis[1] * p[1] + axis[2] * p[2]));
    return [...R[0], back[0], ...R[1], back[1], ...R[2], back[2], 0, 0, 0, 1];
  }

  return { product, links, close, together, displaced, placed, inverse, origin };
})();
