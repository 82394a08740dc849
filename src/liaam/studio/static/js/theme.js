// The theme, light or dark: the user's choice, or else the system's. And the panels that the user has slid away. This
// is not a module, because it must run before the page is drawn, to avoid a flash.

(() => {
  const KEY = "liaam-theme";
  const PANELS = ["strip", "side"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  const { dataset } = document.documentElement;

  /** Read or write the storage; without it, the choice is lost with the page. */
  function stored(key, value = null) {
    try {
      if (value !== null) localStorage.setItem(key, value);
      return localStorage.getItem(key);
    } catch {
      return value;
    }
  }

  function show(theme) {
    dataset.theme = ["light", "dark"].includes(theme) ? theme : system.matches ? "dark" : "light";
    dispatchEvent(new Event("theme"));
  }

  system.addEventListener("change", () => show(stored(KEY)));
  addEventListener("storage", ({ key }) => key === KEY && show(stored(KEY))); // chosen in another tab
  window.liaamTheme = {
    get isDark() { return dataset.theme === "dark"; },
    toggle() { show(stored(KEY, this.isDark ? "light" : "dark")); },
  };
  show(stored(KEY));

  for (const name of PANELS) dataset[name] = stored(`liaam-${name}`) ?? "open";
  /** Slide panels in, or away if any of them is open. */
  window.liaamPanels = (names = PANELS) => {
    const next = names.some((name) => dataset[name] !== "away") ? "away" : "open";
    for (const name of names) dataset[name] = stored(`liaam-${name}`, next);
    dispatchEvent(new Event("panels"));
  };
})();
