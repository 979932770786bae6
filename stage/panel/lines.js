// Lines of text that come at the end: see lines.py.
export default {
  template: '<div tabindex="0" role="log"></div>',
  props: { most: Number },
  methods: {
    push(lines) {
      const list = this.$el;
      const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
      for (const [text, kind] of lines) {
        const line = document.createElement("div");
        line.textContent = text;
        if (kind) line.className = kind;
        list.appendChild(line);
      }
      while (list.childElementCount > this.most) list.firstElementChild.remove();
      if (atEnd) list.scrollTop = list.scrollHeight;
    },
    clear() {
      this.$el.replaceChildren();
    },
  },
};
