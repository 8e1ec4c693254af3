// Draws the robot on a plain canvas: hulls of its links, sorted from far to near.

const LIGHT = normalised([0.4, -0.5, 0.8]);
const GRID = 0.25, GRID_LINES = 8;  // spacing [m], lines to either side
const NEWTONS_PER_METRE = 200, PUSH_CLEARANCE = 0.2;
export const CAMERAS = {
  front: [-0.41, 0.25], side: [-1.57, 0.15], back: [2.73, 0.25], top: [-3.14, 1.5],
};

function normalised(v) {
  const length = Math.hypot(...v);
  return v.map((each) => each / length);
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// A point of the canvas for each point of the world; the camera turns about its target.
class Camera {
  constructor() { [this.yaw, this.pitch] = CAMERAS.front; }

  aim(target, distance, width, height) {
    const c = Math.cos(this.pitch), s = Math.sin(this.pitch);
    const back = [c * Math.cos(this.yaw), c * Math.sin(this.yaw), s];
    this.right = [-Math.sin(this.yaw), Math.cos(this.yaw), 0];
    this.up = cross(back, this.right);
    this.back = back;
    this.eye = target.map((each, k) => each + distance * back[k]);
    this.scale = 1.15 * height;
    this.middle = [width / 2, height / 2];
  }

  // Column, row, and distance in front of the camera.
  see(p) {
    const v = [p[0] - this.eye[0], p[1] - this.eye[1], p[2] - this.eye[2]];
    const depth = -dot(v, this.back), size = this.scale / Math.max(depth, 0.05);
    return [this.middle[0] + size * dot(v, this.right), this.middle[1] - size * dot(v, this.up), depth];
  }
}

export class RobotCanvas {
  constructor(canvas, robot) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.robot = robot;
    this.camera = new Camera();
    // Flat indices: no small arrays are made for each picture.
    this.shapes = robot.shapes.map((shape) => ({...shape, points: shape.vertices.map(() => [0, 0, 0]), seen: []}));
    this.readColours();
  }

  readColours() {
    const probe = document.createElement("span");
    document.body.append(probe);
    const colour = (name) => {
      probe.style.color = `var(--${name})`;
      return getComputedStyle(probe).color;
    };
    this.colours = Object.fromEntries(
      ["ground", "grid", "robot", "com", "push", "limit", "text", "plan", "chosen", "landed"].map((name) => [name, colour(name)]));
    this.body = this.colours.robot.match(/[\d.]+/g).slice(0, 3).map(Number);
    this.font = getComputedStyle(document.body).fontFamily;
    probe.remove();
  }

  draw(joints, state) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), canvas = this.canvas;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const context = this.context, com = state.com;
    const narrow = Math.max(1, 0.62 * height / width);
    this.camera.aim([com[0], com[1], this.robot.focus], 4.2 * this.robot.focus * narrow, width, height);
    context.fillStyle = this.colours.ground;
    context.fillRect(0, 0, width, height);
    this.drawGrid(context, com);
    this.drawSoles(context, state.soles, ratio);
    this.drawHulls(context, joints);
    this.drawMarks(context, joints, state, ratio);
  }

  drawGrid(context, com) {
    context.strokeStyle = this.colours.grid;
    context.lineWidth = 1;
    context.beginPath();
    const middle = [Math.round(com[0] / GRID), Math.round(com[1] / GRID)];
    for (let k = -GRID_LINES; k <= GRID_LINES; k++) {
      for (const axis of [0, 1]) {
        const from = [0, 0, 0], to = [0, 0, 0];
        from[axis] = to[axis] = (middle[axis] + k) * GRID;
        from[1 - axis] = (middle[1 - axis] - GRID_LINES) * GRID;
        to[1 - axis] = (middle[1 - axis] + GRID_LINES) * GRID;
        this.line(context, from, to);
      }
    }
    context.stroke();
  }

  // Footprints of a robot that steps by touch: those that have landed are below the plan's.
  drawSoles(context, soles, ratio) {
    for (const [kind, width] of [["landed", 1.5], ["planned", 2], ["chosen", 4]]) {
      context.strokeStyle = this.colours[kind === "planned" ? "plan" : kind];
      context.lineWidth = width * ratio;
      context.beginPath();
      for (const outline of soles[kind]) {
        for (let k = 1; k < outline.length; k++) this.line(context, outline[k - 1], outline[k]);
      }
      context.stroke();
    }
  }

  line(context, from, to) {
    const a = this.camera.see(from), b = this.camera.see(to);
    if (a[2] < 0.1 || b[2] < 0.1) return;
    context.moveTo(a[0], a[1]);
    context.lineTo(b[0], b[1]);
  }

  // A hull is convex, so its faces towards the camera hide none of each other: only hulls are sorted.
  drawHulls(context, joints) {
    for (const shape of this.shapes) this.place(shape, joints, 7 * shape.joint);
    this.shapes.sort((one, other) => other.depth - one.depth);
    context.lineWidth = 1;
    context.lineJoin = "round";
    const eye = this.camera.eye;
    for (const shape of this.shapes) {
      const faces = [];
      for (const face of shape.faces) {
        const [a, b, c] = [shape.points[face[0]], shape.points[face[1]], shape.points[face[2]]];
        const normal = cross(
          [b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
        if (dot(normal, [eye[0] - a[0], eye[1] - a[1], eye[2] - a[2]]) <= 0) continue;
        faces.push([face, this.shade(shape, normal)]);
      }
      // First the whole, which shows through the seams between neighbours.
      context.beginPath();
      for (const [face] of faces) this.trace(context, shape, face);
      context.fillStyle = context.strokeStyle = this.shade(shape, LIGHT);
      context.fill();
      context.strokeStyle = faces.length ? faces[0][1] : context.strokeStyle;
      context.stroke();
      for (const [face, colour] of faces) {
        context.beginPath();
        this.trace(context, shape, face);
        context.fillStyle = colour;
        context.fill();
      }
    }
  }

  trace(context, shape, face) {
    const [a, b, c] = [shape.seen[face[0]], shape.seen[face[1]], shape.seen[face[2]]];
    context.moveTo(a[0], a[1]);
    context.lineTo(b[0], b[1]);
    context.lineTo(c[0], c[1]);
    context.closePath();
  }

  // Moves a shape's vertices into the world and onto the canvas.
  place(shape, joints, at) {
    const [x, y, z, qx, qy, qz, qw] = joints.slice(at, at + 7);
    shape.vertices.forEach(([vx, vy, vz], k) => {
      const tx = 2 * (qy * vz - qz * vy), ty = 2 * (qz * vx - qx * vz), tz = 2 * (qx * vy - qy * vx);
      const point = shape.points[k];
      point[0] = x + vx + qw * tx + qy * tz - qz * ty;
      point[1] = y + vy + qw * ty + qz * tx - qx * tz;
      point[2] = z + vz + qw * tz + qx * ty - qy * tx;
      shape.seen[k] = this.camera.see(point);
    });
    shape.depth = shape.seen.reduce((sum, seen) => sum + seen[2], 0) / shape.seen.length;
  }

  shade(shape, normal) {
    const lit = 0.45 + 0.55 * Math.max(0, dot(normal, LIGHT) / Math.hypot(...normal));
    const part = (shape.colour[0] + shape.colour[1] + shape.colour[2]) / 765 < 0.4 ? 0.45 : 1;
    const [r, g, b] = this.body.map((each) => Math.round(each * lit * part));
    return `rgb(${r},${g},${b})`;
  }

  drawMarks(context, joints, state, ratio) {
    const com = state.com, ground = [com[0], com[1], 0];
    context.lineWidth = 2 * ratio;
    context.strokeStyle = context.fillStyle = this.colours.com;
    context.beginPath();
    this.line(context, com, ground);
    context.stroke();
    for (const point of [com, ground]) {
      const [column, row] = this.camera.see(point);
      context.beginPath();
      context.arc(column, row, 4 * ratio, 0, 7);
      context.fill();
    }
    const size = Math.hypot(...state.push);
    if (size > 0) this.drawPush(context, joints.slice(0, 3), state.push, size, ratio);
  }

  drawPush(context, base, push, size, ratio) {
    const way = push.map((each) => each / size);
    const tip = base.map((each, k) => each - PUSH_CLEARANCE * way[k]);
    const tail = tip.map((each, k) => each - push[k] / NEWTONS_PER_METRE);
    const [a, b] = [this.camera.see(tail), this.camera.see(tip)];
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]), head = 16 * ratio;
    context.strokeStyle = context.fillStyle = this.colours.push;
    context.lineWidth = 6 * ratio;
    context.beginPath();
    context.moveTo(a[0], a[1]);
    context.lineTo(b[0], b[1]);
    context.stroke();
    context.beginPath();
    context.moveTo(b[0] + head * Math.cos(angle), b[1] + head * Math.sin(angle));
    context.lineTo(b[0] + head * Math.cos(angle + 2.3), b[1] + head * Math.sin(angle + 2.3));
    context.lineTo(b[0] + head * Math.cos(angle - 2.3), b[1] + head * Math.sin(angle - 2.3));
    context.fill();
    context.font = `${14 * ratio}px ${this.font}`;
    context.fillText(`${Math.round(size)} N`, a[0], a[1] - 10 * ratio);
  }
}
