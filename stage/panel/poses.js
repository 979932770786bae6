// Poses of the bodies of a scene, and when the scene is drawn: see stage_scene.py. Only changes are drawn. Without a graphics card the
// processor draws: then the scene is coarse while something moves, and sharp again as soon as it rests.
const PICTURE_MS = 50; // for a picture of a moving scene, at most: as long again is left to the rest of the page
const LONGEST_REST_MS = 200; // between two pictures, also after one that took long
const POLL_MS = 30; // between two looks at whether a picture is drawn
const SETTLED_MS = 300; // without a change: the scene rests
const COARSENESS = [1, 0.7, 0.5, 0.35]; // pixels of a picture for one of the screen, sharpest first

export default {
  template: '<span style="display: none"></span>',
  props: { scene: Number },
  mounted() {
    this.poses = new Map();
    this.wait = setInterval(() => {
      const scene = getElement(this.scene);
      if (!scene?.renderer) return;
      clearInterval(this.wait);
      this.control(scene, scene.renderer);
      this.resizing = new ResizeObserver(() => scene.resize()); // the scene itself follows the window only
      this.resizing.observe(scene.$el);
    }, 50);
  },
  unmounted() {
    clearInterval(this.wait);
    this.resizing?.disconnect();
  },
  methods: {
    move(poses) {
      for (const [object, ...pose] of poses) this.poses.set(object, pose);
    },
    place(scene) {
      for (const [id, [position, rotation]] of this.poses) {
        const mesh = scene.objects.get(id)?.mesh;
        if (!mesh) continue; // it comes later: a new page makes its objects one by one
        this.poses.delete(id);
        mesh.position.set(...position);
        const [x, y, z] = rotation;
        mesh.quaternion.setFromRotationMatrix(mesh.matrix.clone().set(...x, 0, ...y, 0, ...z, 0, 0, 0, 0, 1));
        this.moves++;
      }
    },
    look(scene, camera) {
      // all that a picture depends on; the last digits of the camera drift
      const place = [...camera.position.toArray(), ...camera.quaternion.toArray()].map((v) => v.toFixed(6));
      const ready = [...scene.objects.values()].filter((object) => !object.ready_promise).length;
      return [place, camera.projectionMatrix.elements, ready, this.moves].join();
    },
    control(scene, renderer) {
      const [draw, resize] = [renderer.render.bind(renderer), renderer.setSize.bind(renderer)];
      const gl = renderer.getContext();
      let [drawn, fence, begun, free, changed, level, drawnLevel] = ["", null, 0, 0, 0, 0, 0];
      this.frames = this.moves = 0;
      renderer.render = (what, camera) => {
        const t = performance.now();
        this.place(scene);
        if (fence) {
          if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return;
          gl.deleteSync(fence);
          fence = null;
          const took = t - begun;
          free = begun + Math.min(2 * took, took + LONGEST_REST_MS) - POLL_MS;
          if (drawnLevel === level && took > PICTURE_MS) level = Math.min(level + 1, COARSENESS.length - 1);
          else if (drawnLevel === level && took < 0.4 * PICTURE_MS) level = Math.max(level - 1, 0);
        }
        const now = this.look(scene, camera);
        if (now !== drawn) changed = t;
        const rests = t - changed > SETTLED_MS;
        if (t < free || (now === drawn && !(rests && drawnLevel > 0))) return;
        drawnLevel = rests ? 0 : level;
        const ratio = COARSENESS[drawnLevel] * devicePixelRatio;
        if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
        drawn = now;
        begun = t;
        this.frames++;
        draw(what, camera);
        fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
        gl.flush();
      };
      renderer.setSize = (...size) => {
        drawn = "";
        resize(...size);
      };
    },
  },
};
