// Light or dark: as a person has chosen on this machine, else as the system says. Read before the page is drawn, or it
// would flash; so this is no module, which would wait until the page is there.

(() => {
  const KEY = "liaam-theme";
  const THEMES = ["light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");

  function chosen() {
    try {
      return localStorage.getItem(KEY);
    } catch {
      return null; // without storage a choice lives as long as the page
    }
  }

  function show(theme) {
    document.documentElement.dataset.theme = THEMES.includes(theme) ? theme : system.matches ? "dark" : "light";
    dispatchEvent(new Event("theme"));
  }

  system.addEventListener("change", () => show(chosen()));
  addEventListener("storage", ({ key }) => key === KEY && show(chosen())); // chosen in another tab
  window.liaamTheme = {
    get isDark() {
      return document.documentElement.dataset.theme === "dark";
    },
    toggle() {
      const next = this.isDark ? "light" : "dark";
      try {
        localStorage.setItem(KEY, next);
      } catch {
        // As above.
      }
      show(next);
    },
  };
  show(chosen());
})();
