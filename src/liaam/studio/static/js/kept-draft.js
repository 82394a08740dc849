// A template that is being made, kept until it is saved: a reload must not cost an hour of clicking.

export class KeptDraft {
  constructor(folder) {
    this.key = `liaam-studio:template:${folder}`;
  }

  get() {
    try {
      const kept = JSON.parse(localStorage.getItem(this.key));
      return kept?.names?.length === kept?.points?.length ? kept : null;
    } catch {
      return null;
    }
  }

  set(draft) {
    try {
      if (draft?.names.length) localStorage.setItem(this.key, JSON.stringify(draft));
      else localStorage.removeItem(this.key);
    } catch {
      // Without storage the draft lives as long as the page.
    }
  }
}
