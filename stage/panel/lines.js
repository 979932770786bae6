// Lines of text that come at the end: see browser_updates.py.
export default {
  template: '<div tabindex="0" role="log"></div>',
  props: { most: Number },
  methods: {
    push(lines) {
      const list = this.$el;
      const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
      for (const [text, kind, key] of lines) {
        const again = key && this.last && this.last.key === key;
        const line = again ? this.last.line : document.createElement("div");
        line.textContent = text;
        if (kind) line.className = kind;
        if (!again) list.appendChild(line);
        if (key) this.last = { key, line };
      }
      while (list.childElementCount > this.most) list.firstElementChild.remove();
      if (atEnd) list.scrollTop = list.scrollHeight;
    },
    clear() {
      this.last = null;
      this.$el.replaceChildren();
    },
  },
};
