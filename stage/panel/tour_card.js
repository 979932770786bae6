// Card of the tour, beside the part of the page that it speaks of: see tour_page.py.
const [GAP, EDGE, HEADER, NARROW] = [10, 8, 60, 900]; // pixels

export default {
  template: '<div class="tour-card" role="dialog" aria-label="Tour"><slot></slot></div>',
  props: { target: String, press: String },
  mounted() {
    this.timer = setInterval(this.place, 200); // the page scrolls, and its parts change their sizes
    this.point();
  },
  unmounted() {
    clearInterval(this.timer);
    this.mark(null, null);
  },
  watch: { target: "point", press: "point" },
  methods: {
    find: (name) => document.querySelector(`[data-test="${name}"]`),
    mark(target, press) {
      for (const [name, marked] of Object.entries({ "tour-target": target, "tour-press": press })) {
        for (const element of document.querySelectorAll("." + name)) if (element !== marked) element.classList.remove(name);
        marked?.classList.add(name);
      }
    },
    point() {
      const block = innerWidth > NARROW ? "nearest" : "center";
      setTimeout(() => (this.find(this.press) ?? this.find(this.target))?.scrollIntoView({ block }), 300);
      this.place();
    },
    place() {
      const [target, card] = [this.find(this.target), this.$el];
      this.mark(target, this.find(this.press));
      if (!target || innerWidth <= NARROW) return card.removeAttribute("style"); // at the lower edge
      const [{ left, right, top, bottom }, { width, height }] = [target.getBoundingClientRect(), card.getBoundingClientRect()];
      const [x, y] = [innerWidth - width - EDGE, innerHeight - height - EDGE];
      const places = [[left, bottom + GAP], [right + GAP, top], [left - width - GAP, top], [left, top - height - GAP]];
      const fits = ([a, b]) => a >= EDGE && a <= x && b >= HEADER && b <= y;
      const [a, b] = places.find(fits) ?? places[0];
      card.style.left = Math.min(Math.max(a, EDGE), x) + "px";
      card.style.top = Math.min(Math.max(b, HEADER), y) + "px";
      card.style.bottom = card.style.right = "auto";
    },
  },
};
