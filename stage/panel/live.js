// What changes many times a second: see browser_updates.py. The answer comes after the browser has drawn it.
export default {
  template: '<span style="display: none"></span>',
  methods: {
    show(texts, lamps, calls) {
      for (const [id, text] of texts) {
        const element = document.getElementById("c" + id);
        if (element) element.textContent = text;
      }
      for (const [id, on] of lamps) document.getElementById("c" + id)?.classList.toggle("on", on);
      for (const [id, method, given] of calls) getElement(id)?.[method]?.(...given);
      return new Promise((done) => {
        const hidden = setTimeout(done, 250, true); // a tab that nobody sees draws no frames
        requestAnimationFrame(() => {
          clearTimeout(hidden);
          done(true);
        });
      });
    },
  },
};
