/** Files that were dropped, those in dropped folders included. */

/** Return dropped files; of a folder those that `accept` of an `<input>` takes, each named by its path from that folder on. */
export async function droppedFiles(dropped: DataTransfer, accept: string): Promise<File[]> {
  const entries = [...dropped.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  if (!entries.some((entry) => entry?.isDirectory)) return [...dropped.files];
  const accepted = accept.split(",");
  const takes = (file: File): boolean => !accept || accepted.some((each) => each === file.type || file.name.toLowerCase().endsWith(each));
  const found: File[] = [];
  for (const entry of entries) if (entry) await collect(entry, takes, found);
  return found;
}

async function collect(entry: FileSystemEntry, takes: (file: File) => boolean, found: File[]): Promise<void> {
  if (entry.isDirectory) {
    const reader = (entry as FileSystemDirectoryEntry).createReader();
    // A hundred at a time, none at the end.
    for (let inside: FileSystemEntry[] = []; ; ) {
      inside = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
      if (!inside.length) return;
      for (const each of inside) if (!each.name.startsWith(".")) await collect(each, takes, found);
    }
  }
  const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
  if (takes(file)) found.push(new File([file], entry.fullPath.replace(/^\//, ""), { type: file.type, lastModified: file.lastModified }));
}
