// The theme, light or dark: the user's choice, or else the system's. And the panels that the user has slid away. This
// is not a module, because it must run before the page is drawn, to avoid a flash.

(() => {
  const KEY = "liaam-theme";
  const THEMES = ["light", "dark"];
  const PANELS = ["strip", "side"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  const { dataset } = document.documentElement;

  /** Use the storage; without it, the choice is lost with the page. */
  function attempt(work) {
    try {
      return work();
    } catch {
      return null;
    }
  }

  const recall = (key) => attempt(() => localStorage.getItem(key));
  const keep = (key, value) => attempt(() => localStorage.setItem(key, value));

  function show(theme) {
    dataset.theme = THEMES.includes(theme) ? theme : system.matches ? "dark" : "light";
    dispatchEvent(new Event("theme"));
  }

  system.addEventListener("change", () => show(recall(KEY)));
  addEventListener("storage", ({ key }) => key === KEY && show(recall(KEY))); // chosen in another tab
  window.liaamTheme = {
    get isDark() { return dataset.theme === "dark"; },
    toggle() {
      const next = this.isDark ? "light" : "dark";
      keep(KEY, next);
      show(next);
    },
  };
  show(recall(KEY));

  for (const name of PANELS) dataset[name] = recall(`liaam-${name}`) ?? "open";
  /** Slide panels in, or away if any of them is open. */
  window.liaamPanels = (names = PANELS) => {
    const next = names.some((name) => dataset[name] !== "away") ? "away" : "open";
    for (const name of names) {
      dataset[name] = next;
      keep(`liaam-${name}`, next);
    }
    dispatchEvent(new Event("panels"));
  };
})();
