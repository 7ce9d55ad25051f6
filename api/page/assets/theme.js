// Light or dark before anything is drawn: what was chosen here, else what the system prefers.
(() => {
  const KEPT = "treadwatch.theme";
  const preferred = matchMedia("(prefers-color-scheme: dark)");
  const kept = () => {
    try {
      return localStorage.getItem(KEPT);
    } catch {
      return null; // storage is switched off
    }
  };
  const apply = () => {
    document.documentElement.dataset.theme = kept() ?? (preferred.matches ? "dark" : "light");
    window.dispatchEvent(new Event("themechange"));
  };
  preferred.addEventListener("change", apply);
  window.toggleTheme = () => {
    const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    try {
      localStorage.setItem(KEPT, next);
    } catch {
      // lasts as long as the page
    }
    document.documentElement.dataset.theme = next;
    window.dispatchEvent(new Event("themechange"));
  };
  apply();
})();
