// Renders heads, each in the rectangle of a page element, from rows of numbers (format: apps/viewer/pose_encoding.py).
//
//   const stage = await Stage.open(canvas, "head.glb", [element, ...]);
//   stage.pose(0, row);  // Float32Array: translation, four quaternions, weights
//   stage.draw();
//
// The canvas lies under the elements (the canvas itself may be the only element). All heads share one camera, which
// the mouse rotates. three.js is at ./three.js (apps/viewer/assets.py).

import { THREE, GLTFLoader, OrbitControls } from "./three.js";

const JOINTS = ["neck", "jaw", "left_eye", "right_eye"]; // in the order of the quaternions of a row
const FORWARD = new THREE.Vector3(0, 0, 1); // of an eye: its line of sight, on which its pupil lies
const WEIGHTS = 3 + 4 * JOINTS.length; // index of the first weight in a row
const FAR_M = 6; // lines of sight that meet farther away count as parallel
const RAY_RADIUS_M = 0.0004; // of a gaze ray at the pupil
const DEFAULT_DISTANCE_M = 1; // length of gaze rays that do not meet (animation/targets.py)
const AWAY_M = 0.9; // distance of the camera from its target

// The framings of rendering/view.py, metres and degrees; that of the eyes is taller, because these pictures are not wider than tall.
export const VIEWS = {
  head: { height: 0.285, pivot: [0, 0.03, 0], yaw: 0 },
  face: { height: 0.205, pivot: [0, 0.01, 0.06], yaw: 0 },
  eyes: { height: 0.14, pivot: [0, 0.046, 0.09], yaw: 0 },
  left: { height: 0.285, pivot: [0, 0.03, 0], yaw: 45 },
  right: { height: 0.285, pivot: [0, 0.03, 0], yaw: -45 },
};

export class Stage {
  static async open(canvas, address, cells) {
    const answer = await fetch(address);
    if (!answer.ok) throw new Error(`the head could not be loaded (${answer.status})`);
    const stage = new Stage(canvas, cells);
    await stage.place(await answer.arrayBuffer());
    return stage;
  }

  constructor(canvas, cells) {
    this.canvas = canvas;
    this.cells = cells;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.autoClear = false;
    this.camera = new THREE.PerspectiveCamera(18, 1, 0.05, 20);
    this.controls = cells.map((cell) => {
      const controls = new OrbitControls(this.camera, cell);
      Object.assign(controls, { enablePan: false, minDistance: 0.25, maxDistance: 5 });
      return controls;
    });
    this.heads = [];
  }

  // Load the heads at rest. They share the geometry, by far their largest part.
  async place(glb) {
    let shared = null;
    for (const cell of this.cells) {
      const { scene } = await new GLTFLoader().parseAsync(glb, "");
      const mesh = scene.getObjectByProperty("isSkinnedMesh", true);
      shared ??= mesh.geometry;
      mesh.geometry = shared;
      mesh.frustumCulled = false;
      const joints = JOINTS.map((name) => scene.getObjectByName(name));
      this.heads.push({ cell, mesh, joints, scene: lit(scene), root: scene.getObjectByName("root"), rays: rays(mesh, joints.slice(2)) });
    }
    this.look("head");
  }

  look(name) {
    const { height, pivot, yaw } = VIEWS[name];
    const angle = (yaw * Math.PI) / 180;
    this.camera.fov = (2 * Math.atan(height / 2 / AWAY_M) * 180) / Math.PI;
    this.camera.position.set(pivot[0] + Math.sin(angle) * AWAY_M, pivot[1], pivot[2] + Math.cos(angle) * AWAY_M);
    for (const controls of this.controls) {
      controls.target.set(...pivot);
      controls.update();
    }
  }

  pose(index, row) {
    const { mesh, root, joints } = this.heads[index];
    root.position.fromArray(row, 0);
    joints.forEach((joint, place) => joint.quaternion.fromArray(row, 3 + 4 * place));
    const weights = mesh.morphTargetInfluences;
    for (let shape = 0; shape < weights.length; shape++) weights[shape] = row[WEIGHTS + shape];
    this.#aim(index);
  }

  // End the gaze rays of a head at what it looks at.
  #aim(index) {
    const { joints, rays } = this.heads[index];
    const axes = joints.slice(2).flatMap((eye) => [eye.position, FORWARD.clone().applyQuaternion(eye.quaternion)]);
    fixationDistances(...axes).forEach((distance, eye) => (rays[eye].scale.z = distance - rays[eye].position.z));
  }

  showRays(shown) {
    for (const head of this.heads) for (const ray of head.rays) ray.visible = shown;
  }

  draw() {
    const { renderer, canvas, camera } = this;
    const page = canvas.getBoundingClientRect();
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    for (const { cell, scene } of this.heads) {
      const box = cell.getBoundingClientRect();
      const place = [box.left - page.left, page.bottom - box.bottom, box.width, box.height];
      renderer.setViewport(...place);
      renderer.setScissor(...place);
      camera.aspect = box.width / box.height;
      camera.updateProjectionMatrix();
      renderer.clear();
      renderer.render(scene, camera);
    }
  }
}

function lit(scene) {
  const stage = new THREE.Scene();
  stage.background = new THREE.Color(0xf4f3f0);
  stage.add(scene, new THREE.HemisphereLight(0xffffff, 0x9a8f86, 1.6));
  const key = new THREE.DirectionalLight(0xffffff, 1.9);
  key.position.set(0.5, 0.8, 1.2);
  stage.add(key);
  return stage;
}

// Distances, from the centres of both eyes along their forward axes (unit vectors), to where these lines are closest to
// each other: to what is looked at. Lines that do not meet within FAR_M in front of the eyes: DEFAULT_DISTANCE_M.
export function fixationDistances(left, leftAxis, right, rightAxis) {
  const between = left.clone().sub(right);
  const cosine = leftAxis.dot(rightAxis);
  const [alongLeft, alongRight] = [leftAxis.dot(between), rightAxis.dot(between)];
  const distances = [cosine * alongRight - alongLeft, alongRight - cosine * alongLeft].map((reach) => reach / (1 - cosine ** 2));
  return distances.every((distance) => distance > 0 && distance < FAR_M) ? distances : [DEFAULT_DISTANCE_M, DEFAULT_DISTANCE_M];
}

// A needle for each eye, from its pupil to a point on its forward axis; `pose` sets its length. (Some drivers draw no lines.)
function rays(mesh, eyes) {
  const geometry = new THREE.ConeGeometry(RAY_RADIUS_M, 1, 8).rotateX(Math.PI / 2).translate(0, 0, 0.5); // from 0 to +z
  return eyes.map((eye) => {
    const ray = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: 0xd1495b }));
    ray.position.z = pupilDistance(mesh, eye);
    ray.frustumCulled = false;
    ray.visible = false;
    eye.add(ray);
    return ray;
  });
}

// Distance from the centre of an eye to the foremost of its vertices, with the head at rest.
function pupilDistance(mesh, eye) {
  const { position, skinIndex } = mesh.geometry.attributes;
  const joint = mesh.skeleton.bones.indexOf(eye);
  const centre = mesh.skeleton.boneInverses[joint].elements[14]; // minus the z of the centre
  let most = 0;
  for (let vertex = 0; vertex < position.count; vertex++) {
    if (skinIndex.getX(vertex) === joint) most = Math.max(most, position.getZ(vertex) + centre);
  }
  return most;
}
