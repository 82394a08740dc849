// The theme, light or dark: the user's choice, or else the system's. This is not a module, because it must run before
// the page is drawn, to avoid a flash.

(() => {
  const KEY = "liaam-theme";
  const THEMES = ["light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");

  function chosen() {
    try {
      return localStorage.getItem(KEY);
    } catch {
      return null; // without storage, the choice is lost with the page
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
