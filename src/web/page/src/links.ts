// Links to a machine: simulated in the page, at a serial port, or at a WebSocket. All have the same interface.
import type { Order } from "./engine";
import { worker } from "./firmware";
import type { Link } from "./sender";
import type { Task } from "./worker";

/** A simulated machine, which runs in a worker of the page. */
export class PageLink implements Link {
  onsaid: (text: string) => void = () => {};
  onlost: (why: string) => void = () => {};
  readonly greets = true;
  private readonly machine = worker();

  constructor(order: Order) {
    this.machine.onmessage = ({ data }) => {
      if (data.is === "said") this.onsaid(data.text);
      if (data.is === "failed") this.onlost(data.why);
    };
    this.tell({ task: "power", order });
  }

  write(bytes: Uint8Array): void {
    this.tell({ task: "send", bytes });
  }

  /** Sets an input pin, such as `probe 1`. */
  pin(line: string): void {
    this.tell({ task: "pin", line });
  }

  /** Sets the ratio of machine time to real time. */
  speed(times: number): void {
    this.tell({ task: "speed", times });
  }

  close(): void {
    this.machine.terminate();
  }

  private tell(task: Task): void {
    this.machine.postMessage(task);
  }
}

/** Calls `call` every `interval` ms, even in a hidden page, where browsers suspend timers. Returns a function that ends
 * the calls. */
export function every(interval: number, call: () => void): () => void {
  const timer = new Worker(URL.createObjectURL(new Blob(["onmessage = ({ data }) => setInterval(() => postMessage(0), data)"], { type: "text/javascript" })));
  timer.onmessage = call;
  timer.postMessage(interval);
  return () => timer.terminate();
}

/** Maximum time to wait for the last bytes when a port is closed, ms. */
const LONGEST_CLOSE = 1000;

interface SerialPort {
  open(options: { baudRate: number; bufferSize?: number }): Promise<void>;
  close(): Promise<void>;
  readable: ReadableStream<Uint8Array> | null;
  writable: WritableStream<Uint8Array> | null;
}
interface Serial { requestPort(): Promise<SerialPort> }

export const serial = (): Serial | undefined => (navigator as unknown as { serial?: Serial }).serial;

/** A board at a serial port, by Web Serial. */
export class SerialLink implements Link {
  onsaid: (text: string) => void = () => {};
  onlost: (why: string) => void = () => {};
  private readonly writer: WritableStreamDefaultWriter<Uint8Array>;
  private readonly reader: ReadableStreamDefaultReader<Uint8Array>;

  private constructor(private readonly port: SerialPort) {
    if (!port.readable || !port.writable) throw new Error("the port is not open");
    this.writer = port.writable.getWriter();
    this.reader = port.readable.getReader();
    void this.read();
  }

  /** Lets the user choose a port, and opens it. */
  static async open(baudRate: number): Promise<SerialLink> {
    const ports = serial();
    if (!ports) throw new Error("this browser has no Web Serial");
    const port = await ports.requestPort();
    await port.open({ baudRate, bufferSize: 4096 });
    return new SerialLink(port);
  }

  write(bytes: Uint8Array): void {
    this.writer.write(bytes).catch(error => this.onlost(String(error)));
  }

  /** Closes the port after all bytes have been written, but waits at most `LONGEST_CLOSE`. */
  async close(): Promise<void> {
    // Each step can fail if the board has left the bus. Ignore the error, and go on to close the port.
    await Promise.race([this.writer.close(), new Promise(resolve => setTimeout(resolve, LONGEST_CLOSE))]).catch(() => {});
    this.writer.releaseLock();
    await this.reader.cancel().catch(() => {});
    this.reader.releaseLock();
    await this.port.close().catch(() => {});
  }

  private async read(): Promise<void> {
    const decoder = new TextDecoder();
    try {
      for (;;) {
        const { value, done } = await this.reader.read();
        if (done) break;
        this.onsaid(decoder.decode(value, { stream: true }));
      }
      this.onlost("the port is closed");
    } catch (error) {
      this.onlost(String(error));
    }
  }
}

/** Returns the address of the machine if the page was served by `oxmill serve --web`. */
export function servedMachine(): string | undefined {
  const path = document.querySelector<HTMLMetaElement>("meta[name=oxmill-machine]")?.content;
  return path && `ws://${location.host}${path}`;
}

/** A machine behind a WebSocket, such as that of `oxmill serve --web`. */
export class SocketLink implements Link {
  onsaid: (text: string) => void = () => {};
  onlost: (why: string) => void = () => {};

  private constructor(private readonly socket: WebSocket) {
    const decoder = new TextDecoder();
    socket.onmessage = ({ data }) => this.onsaid(decoder.decode(data as ArrayBuffer, { stream: true }));
    socket.onclose = () => this.onlost("the connection is closed");
  }

  static open(url: string): Promise<SocketLink> {
    return new Promise((resolve, reject) => {
      const socket = new WebSocket(url);
      socket.binaryType = "arraybuffer";
      const link = new SocketLink(socket);
      socket.onopen = () => resolve(link);
      socket.onerror = () => reject(new Error("the machine does not answer"));
    });
  }

  write(bytes: Uint8Array<ArrayBuffer>): void {
    this.socket.send(bytes);
  }

  close(): void {
    this.socket.onclose = null;
    this.socket.close();
  }
}
