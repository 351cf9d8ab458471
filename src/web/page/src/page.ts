// What the panels know of the page: the job, what the firmware has made of it, and the settings that it was checked with.
import type { Description, Order, Path, Summary } from "./engine";
import type { Checked } from "./firmware";
import type { Material } from "./material";

export interface Job { name: string; bytes: Uint8Array; text: string; lines: string[] }
export const NO_JOB: Job = { name: "", bytes: new Uint8Array(0), text: "", lines: [] };

export type Workspace = "first" | "check" | "run" | "settings";

/** Values of settings, as the forecast has them. */
export interface Values {
  value(number: number): number;
  /** Those that differ from a new controller's. */
  values(): Record<string, number>;
  replace(values: Record<string, number>): void;
}

/** The picture, the time and the list of lines. */
export interface Timeline {
  /** The time that is shown, s, and the line that the tool is at. */
  readonly time: number;
  readonly line: number;
  seek(seconds: number): void;
  goToLine(line: number): void;
  showBlock(material?: Material, withPath?: boolean): void;
}

/** The page, as a panel sees it. */
export interface Page {
  readonly description: Description;
  readonly job: Job;
  readonly checked?: Checked;
  readonly settings: Values;
  readonly player: Timeline;
  /** What a check is made with. */
  order(more?: Order): Order;
  /** Opens a job, and checks it. */
  open(name: string, bytes: Uint8Array): void;
  go(workspace: Workspace): void;
}

/** A panel that shows what was made of a job. */
export interface JobPanel {
  /** A job has been checked. */
  show?(path: Path, summary: Summary): void;
  /** Another job, or other settings: what is shown is void. */
  clear(): void;
}
