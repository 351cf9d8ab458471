// Shows one of Check, Run and Settings, and arranges their cards on narrow screens.
import { $ } from "./dom";
import type { Workspace } from "./page";
import { choose, tabs } from "./tabs";

type Part = "control" | "job" | "picture" | "more";
/** Cards that are in tabs below the picture on screens of medium width: card, its usual column, and its tab panel. */
const CARDS = [["card-over", "run-left", "pane-over"], ["card-spindle", "run-left", "pane-spindle"], ["card-setup", "run-right", "pane-setup"]] as const;
const BELOW = ["tab-over", "tab-spindle", "tab-setup"];

export class Workspaces {
  private readonly narrow = matchMedia("(max-width: 699px)");
  private readonly medium = matchMedia("(min-width: 700px) and (max-width: 1199px)");

  constructor(private readonly onchange: () => void) {
    for (const button of document.querySelectorAll<HTMLElement>("[data-go]")) {
      button.addEventListener("click", () => this.go(button.dataset.go as Workspace));
    }
    for (const button of document.querySelectorAll<HTMLElement>(".parts button")) {
      button.addEventListener("click", () => this.part(button.dataset.part as Part));
    }
    tabs("dock-tabs");
    tabs("analysis-tabs");
    this.medium.addEventListener("change", () => this.place());
    this.narrow.addEventListener("change", () => this.landmarks());
    this.place();
    this.part("control");
    this.go("first");
  }

  get now(): Workspace {
    return $("app").dataset.workspace as Workspace;
  }

  go(workspace: Workspace): void {
    $("app").dataset.workspace = workspace;
    for (const button of document.querySelectorAll<HTMLElement>(".nav [data-go], .bottom [data-go]")) {
      if (button.dataset.go === workspace) button.setAttribute("aria-current", "page");
      else button.removeAttribute("aria-current");
    }
    if (workspace !== "run" && BELOW.some(id => $(id).getAttribute("aria-selected") === "true")) choose("tab-program");
    this.landmarks();
    this.onchange();
  }

  /** Selects the part of Run that a telephone shows. */
  part(part: Part): void {
    $("app").dataset.part = part;
    for (const button of document.querySelectorAll<HTMLElement>(".parts button")) {
      if (button.dataset.part === part) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    }
    if (part === "more") choose("tab-log");
    this.landmarks();
    this.onchange();
  }

  /** Marks the visible part of Run as the main part of the page, for screen readers on a telephone. */
  private landmarks(): void {
    const { part } = $("app").dataset;
    for (const [id, shows] of [["run-left", "job"], ["run-right", "control"]]) {
      $(id).setAttribute("role", this.narrow.matches && this.now === "run" && part === shows ? "main" : "complementary");
    }
  }

  private place(): void {
    for (const [card, column, pane] of CARDS) $(this.medium.matches ? pane : column).append($(card));
    $("run-left").append($("card-modes"));
    if (!this.medium.matches && BELOW.some(id => $(id).getAttribute("aria-selected") === "true")) choose("tab-program");
  }
}
