// The interface of the page to its panels: the job, its results, and the settings that it was checked with.
import type { Description, Order, Path, Summary } from "./engine";
import type { Checked } from "./firmware";
import type { Material } from "./material";

export interface Job { name: string; bytes: Uint8Array; text: string; lines: string[] }
export const NO_JOB: Job = { name: "", bytes: new Uint8Array(0), text: "", lines: [] };

export type Workspace = "first" | "check" | "run" | "settings";

/** The settings with which the forecast is made. `number`: the number of a setting, such as 110 for `$110`. */
export interface Values {
  value(number: number): number;
  /** The values that differ from those of a new controller. */
  values(): Record<string, number>;
  replace(values: Record<string, number>): void;
}

/** Picture, time and list of lines. */
export interface Timeline {
  /** The displayed time, s. */
  readonly time: number;
  /** The line that the tool is at. */
  readonly line: number;
  seek(seconds: number): void;
  goToLine(line: number): void;
  showBlock(material?: Material, withPath?: boolean): void;
}

export interface Page {
  readonly description: Description;
  readonly job: Job;
  readonly checked?: Checked;
  readonly settings: Values;
  readonly player: Timeline;
  /** Returns the order for a check of the job with the present settings. `more` replaces or adds parts of it. */
  order(more?: Order): Order;
  /** Opens a job and checks it. */
  open(name: string, bytes: Uint8Array): void;
  go(workspace: Workspace): void;
}

/** A panel that shows results of a job. */
export interface JobPanel {
  show?(path: Path, summary: Summary): void;
  /** Clears the results, because the job or the settings have changed. */
  clear(): void;
}
