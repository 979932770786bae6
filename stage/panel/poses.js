// Where the bodies of a scene are: see stage_scene.py. The scene is drawn when something in it has changed, not all the time. A machine
// without a graphics card draws it by its processor: fewer pictures then, and coarser ones, so that the rest of the page lives.
const SLOW = 70; // ms for a picture
const REST = 2; // as long as a slow picture took, times this, nothing is drawn
const COARSEST = 0.5; // pixels of the picture for one of the page

function looks(scene, camera) {
  const place = (o) => [...o.position.toArray(), ...o.quaternion.toArray()].map((v) => v.toFixed(6)); // the controls' last digits drift
  const parts = [place(camera), camera.projectionMatrix.elements];
  scene.traverse((o) => parts.push(o.id, o.visible, place(o)));
  return parts.join();
}

export default {
  template: '<span style="display: none"></span>',
  props: { scene: Number },
  mounted() {
    const wait = setInterval(() => {
      const scene = getElement(this.scene);
      if (!scene?.renderer) return;
      clearInterval(wait);
      const { renderer } = scene;
      const [draw, resize] = [renderer.render.bind(renderer), renderer.setSize.bind(renderer)];
      const gl = renderer.getContext();
      let [drawn, fence, begun, free, slow] = ["", null, 0, 0, 0];
      this.frames = 0;
      renderer.render = (what, camera) => {
        const t = performance.now();
        if (fence) {
          if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return;
          gl.deleteSync(fence);
          fence = null;
          const took = t - begun;
          slow = took > SLOW ? slow + 1 : 0;
          if (slow) free = t + REST * took;
          if (slow > 2 && renderer.getPixelRatio() > COARSEST) renderer.setPixelRatio(COARSEST);
        }
        const now = looks(what, camera);
        if (now === drawn || t < free) return;
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
    }, 50);
  },
  methods: {
    move(poses) {
      const scene = getElement(this.scene);
      if (!scene?.objects) return;
      for (const [object, place, turn] of poses) {
        scene.move(object, ...place);
        scene.rotate(object, turn);
      }
    },
  },
};
